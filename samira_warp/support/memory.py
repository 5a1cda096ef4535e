"""How this process's allocator treats freed memory."""

from __future__ import annotations

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of the two settings in glibc's mallopt."""

_KEPT = 1 << 30
"""Bytes."""


def keep_freed_memory() -> None:
    """Let glibc keep up to a gigabyte of freed memory for the next request.

    Else it gives it back to the system at once. Every step and frame asks for the same megabytes again, and
    each page that comes back from the system costs a page fault: a quarter of the time of projection and
    binning at 50,000 Gaussians. For a process of our own only, since it holds for all of it; where there is
    no glibc, nothing happens.
    """
    if not sys.platform.startswith("linux"):
        return
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_TRIM_THRESHOLD, _KEPT)
        library.mallopt(_MMAP_THRESHOLD, _KEPT)
