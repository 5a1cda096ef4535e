"""The number of threads that torch uses, kept where a library changes it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch


@contextlib.contextmanager
def kept_threads() -> Iterator[None]:
    """Leave the number of threads that torch uses as it was before the block, or the decorated function.

    Libraries that start threads of OpenMP set their number for everything that uses OpenMP, torch with it: so
    numba does when pymatting is imported. Sums that torch divides among other threads end in other bits, and
    more threads than were asked for take the cores of other processes.
    """
    before = torch.get_num_threads()
    try:
        yield
    finally:
        if torch.get_num_threads() != before:
            torch.set_num_threads(before)
