"""Where torch meets Warp: array descriptors, streams, threads and launches.

Every operator in this folder reaches its kernels through `launch` or `launch_range`; nothing else knows about streams or threads.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
import warp as wp

CHUNKS_PER_THREAD = 8
"""A range launch is cut into this many pieces per thread, so that an uneven piece does not leave a core idle."""


def launch(kernel: wp.Kernel, dim: int | tuple[int, ...], *arguments: Any, block_dim: int | None = None) -> None:
    """Run ``kernel`` over ``dim`` on the device, and in the current stream, of its first tensor argument.

    Tensors become array descriptors of the element type that the kernel's signature declares, without copies: they must be contiguous
    and outlive the launch. Other arguments pass through.
    """
    device = _device_of(arguments)
    _load(kernel, str(device), block_dim)
    inputs = _describe(kernel, arguments)
    options = {} if block_dim is None else {"block_dim": block_dim}
    if device.type == "cuda":
        wp.launch(kernel, dim, inputs=inputs, device=str(device), stream=_current_stream(device), **options)
    else:
        wp.launch(kernel, dim, inputs=inputs, device="cpu", **options)


def launch_range(kernel: wp.Kernel, count: int, *arguments: Any, grain: int = 1) -> None:
    """Run ``kernel`` for the indices 0 to ``count`` - 1, on as many CPU threads as torch uses (`torch.set_num_threads`).

    The kernel's first parameter must be ``first: wp.int32`` and its index ``first + wp.tid()``; every index writes only what belongs to
    it, so the result has the same bits for any number of threads. ``arguments`` are the parameters after the first.
    On a GPU it is one launch.

    Args:
        kernel: The kernel.
        count: Number of indices; 0 does nothing.
        *arguments: Tensors and values, as for `launch`.
        grain: Least number of indices that are worth a thread.
    """
    device = _device_of(arguments)
    threads = 1 if device.type == "cuda" else torch.get_num_threads()
    if count == 0:
        return
    if threads == 1 or count <= grain:
        launch(kernel, count, 0, *arguments)
        return
    _load(kernel, str(device), None)
    inputs = _describe(kernel, (0, *arguments))[1:]
    size = max(grain, -(-count // (threads * CHUNKS_PER_THREAD)))

    def run(first: int) -> None:
        wp.launch(kernel, min(size, count - first), inputs=[first, *inputs], device="cpu")

    for _ in _pool(threads).map(run, range(0, count, size)):
        pass


@contextlib.contextmanager
def stream_of(device: torch.device) -> Iterator[None]:
    """Make Warp's own utilities (sort, scan) work in torch's current stream of ``device``; nothing to do on the CPU."""
    _start()
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(_current_stream(device)):
        yield


def warp_array(tensor: torch.Tensor, dtype: Any = None) -> wp.array:
    """A Warp view of a tensor, for `wp.utils` functions, which take arrays rather than descriptors."""
    _start()
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


@functools.cache
def _start() -> None:
    """Initialise Warp without its banner, and without its warning that a machine has no GPU."""
    level = wp.config.log_level
    wp.config.log_level = max(level, wp.LOG_ERROR)
    try:
        wp.init()
    finally:
        wp.config.log_level = max(level, wp.LOG_WARNING)


@functools.cache
def _load(kernel: wp.Kernel, device: str, block_dim: int | None) -> None:
    """Compile and load a kernel's module once, before any thread launches it: loading is not thread-safe."""
    _start()
    wp.load_module(module=kernel.module, device=device, block_dim=block_dim)


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="samira-warp")


def _current_stream(device: torch.device) -> wp.Stream:
    return _wrap_stream(device.index or 0, torch.cuda.current_stream(device).cuda_stream)


@functools.lru_cache(maxsize=16)
def _wrap_stream(index: int, handle: int) -> wp.Stream:
    _start()
    return wp.Stream(f"cuda:{index}", cuda_stream=handle)


def _device_of(arguments: tuple[Any, ...]) -> torch.device:
    for argument in arguments:
        if isinstance(argument, torch.Tensor):
            return argument.device
    raise TypeError("a launch needs at least one tensor argument to tell its device")


def _describe(kernel: wp.Kernel, arguments: tuple[Any, ...]) -> list[Any]:
    return [
        wp.from_torch(value.detach(), dtype=parameter.type.dtype, return_ctype=True, requires_grad=False)
        if isinstance(value, torch.Tensor)
        else value
        for parameter, value in zip(kernel.adj.args, arguments, strict=True)
    ]
