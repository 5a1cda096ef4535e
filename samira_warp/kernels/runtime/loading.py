"""Loading kernels: a module at a time, and with a word where they have to be compiled first."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import torch
import warp as wp

from samira_warp.support.warp_start import WARP_STATE, start_warp, warp_may_talk

QUIET_SECONDS = 1.0
"""After so long without another the last compilation is taken to be over: a step's modules follow each other
within it."""


def load(module: wp.Module, device: torch.device, block_dim: int | None = None) -> None:
    """Load a module's kernels, compiling them where Warp's kernel cache does not have them.

    A process's first compilation is announced by one line on standard error and, once no other follows,
    closed by one that says how long all of them took. Setting `warp.config.log_level` to `warp.LOG_WARNING`
    before Warp is used keeps both off.
    """
    start_warp()
    with WARP_STATE:
        said = contextlib.nullcontext() if _is_cached(module, device, block_dim) else _notice.of(device)
        with said:
            wp.load_module(module=module, device=str(device), block_dim=block_dim)


def _is_cached(module: wp.Module, device: torch.device, block_dim: int | None) -> bool:
    """Whether a module's binary lies in Warp's kernel cache.

    There is a folder for each hash of a module's source, options and threads to a block, with a binary in it
    for each kind of device. What another machine has compiled for another architecture passes for this one's.
    """
    if device.type == "cpu" and (block_dim is None or not wp.config.enable_cpu_blocks):
        block_dim = 1
    folder = Path(wp.config.kernel_cache_dir) / module.get_module_identifier(block_dim)
    kinds = (".o",) if device.type == "cpu" else (".ptx", ".cubin")
    return any(path.suffix in kinds for path in folder.glob("*"))


class _Notice:
    """What a process says of its compilations: a line as the first begins, one when they seem to be over."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._device: torch.device | None = None
        self._over = False
        self._seconds = 0.0
        self._end = threading.Timer(0.0, self._close)

    @contextlib.contextmanager
    def of(self, device: torch.device) -> Iterator[None]:
        """One compilation."""
        if self._over or not warp_may_talk():
            yield
            return
        self._end.cancel()
        with self._lock:
            if self._device is None:
                self._device = device
                _say(f"compiling kernels for {device}, once, into {wp.config.kernel_cache_dir}")
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._seconds += time.perf_counter() - begin
            # no daemon: a process that ends before then waits for its line
            self._end = threading.Timer(QUIET_SECONDS, self._close)
            self._end.start()

    def _close(self) -> None:
        with self._lock:
            self._over = True
            _say(f"compiled kernels for {self._device} in {self._seconds:.1f} s")


_notice = _Notice()


def _say(line: str) -> None:
    """Write a line to standard error, above any progress bars."""
    from tqdm import tqdm  # what only a compilation needs is loaded by it

    tqdm.write(line, file=sys.stderr)
