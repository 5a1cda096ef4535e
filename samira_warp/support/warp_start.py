"""Starting Warp: once, by one thread, and without a word."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections.abc import Iterator

import warp as wp

WARP_STATE = threading.RLock()
"""Held while a thread changes what Warp keeps for the whole process: while Warp starts, while it loads a
module, and while its utilities work in a stream that is lent to them.

One lock for all of them, and one that its holder may take again: the collector may free a mesh, which needs
it, amid any of them.
"""

_NO_DRIVER = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver."
"""What Warp's native code writes to file descriptor 2 of a machine without a GPU, whatever the log level."""

_own = threading.local()
"""Whether a thread knows that Warp has started."""


def start_warp() -> None:
    """Initialise Warp, if nobody has, without its banner and its warnings that a machine has no GPU."""
    if not _own.__dict__.get("started"):
        with WARP_STATE:
            _initialize()
        _own.started = True


def warp_may_talk() -> bool:
    """Whether Warp's user wants to hear what is going on.

    `warp.config.log_level` says so: as it was before Warp was started here, which raises it to spare
    everybody a line for each module that is loaded, and as it is now.
    """
    return _initialize() <= wp.LOG_INFO and wp.config.log_level <= wp.LOG_WARNING


@functools.cache
def _initialize() -> int:
    """Initialise Warp; the log level that was set before."""
    level = wp.config.log_level
    wp.config.log_level = max(level, wp.LOG_ERROR)
    try:
        with contextlib.nullcontext() if _has_driver() else _standard_error_without(_NO_DRIVER):
            wp.init()
    finally:
        wp.config.log_level = max(level, wp.LOG_WARNING)
    return level


def _has_driver() -> bool:
    """Whether there is a CUDA driver where Warp looks for one; True on other systems than Linux."""
    if not sys.platform.startswith("linux"):
        return True
    for name in ("libcuda.so", "libcuda.so.1"):
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


@contextlib.contextmanager
def _standard_error_without(beginning: bytes) -> Iterator[None]:
    """Leave out the lines with a beginning from what this process writes to file descriptor 2 meanwhile.

    All other lines, whichever thread's, are written at the end.
    """
    try:
        real = os.dup(2)
    except OSError:
        # standard error is closed
        yield
        return
    with open(os.memfd_create("standard error"), "r+b") as held:
        _flush()
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            _flush()
            os.dup2(real, 2)
            os.close(real)
            held.seek(0)
            kept = b"".join(line for line in held if not line.startswith(beginning))
            with contextlib.suppress(OSError):
                os.write(2, kept)


def _flush() -> None:
    """Write out what Python holds back of standard error."""
    with contextlib.suppress(OSError, ValueError):
        if sys.stderr is not None:
            sys.stderr.flush()
