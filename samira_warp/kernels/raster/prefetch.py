"""Asking for memory ahead of time, where a kernel walks an array in an order that is not memory's.

In the order of depth a CPU waits for every row, since it guesses the next address only for strides; with the
hint the rows of some ranks ahead are on their way. A GPU hides the wait behind other threads, and the hint
does nothing there.
"""

from __future__ import annotations

import warp as wp

AHEAD = wp.constant(16)
"""Ranks: time enough for memory to answer, few enough to stay in the first cache."""

_PREFETCH = """
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(rows.data + (size_t)row * rows.shape[1]);
#endif
"""


@wp.func_native(_PREFETCH)
def prefetch_floats(rows: wp.array2d[wp.float32], row: wp.int32) -> None:
    """Ask for the beginning of a row."""


@wp.func_native(_PREFETCH)
def prefetch_integers(rows: wp.array2d[wp.int64], row: wp.int32) -> None:
    """Ask for the beginning of a row."""
