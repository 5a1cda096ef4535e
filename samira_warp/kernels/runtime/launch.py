"""Where torch meets Warp: launches, on as many threads as torch uses.

Every operator in `samira_warp.kernels` reaches its kernels through `launch` or `launch_range`.
"""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime.commands import command_of
from samira_warp.support.warp_start import start_warp

CHUNKS_PER_THREAD = 8
"""A range launch is cut into this many pieces per thread, so that an uneven piece does not leave a core
idle."""


def launch(
    kernel: wp.Kernel, dim: int | tuple[int, ...], *arguments: Any, block_dim: int | None = None
) -> None:
    """Run ``kernel`` over ``dim`` on the device, and in the current stream, of its first tensor argument.

    Tensors become array descriptors of the element type that the kernel's signature declares, without copies.
    Other arguments pass through.
    """
    command = command_of(kernel, _device_of(arguments), block_dim)
    command.set_arguments(command.describe(arguments))
    command.run(dim)


def launch_range(kernel: wp.Kernel, count: int, *arguments: Any, grain: int = 1) -> None:
    """Run ``kernel`` for the indices 0 to ``count`` - 1, on as many CPU threads as torch uses.

    Torch uses as many as the process may use cores; `torch.set_num_threads` and OMP_NUM_THREADS change that.
    The kernel's first parameter must be ``first: wp.int32`` and its index ``first + wp.tid()``; every index
    writes only what belongs to it, so the result has the same bits for any number of threads. ``arguments``
    are the parameters after the first. On a GPU it is one launch.

    Args:
        kernel: The kernel.
        count: Number of indices; 0 does nothing.
        *arguments: Tensors and values, as for `launch`.
        grain: Least number of indices that are worth a thread.
    """
    if count == 0:
        return
    device = _device_of(arguments)
    threads = 1 if device.type == "cuda" else torch.get_num_threads()
    if threads == 1 or count <= grain:
        launch(kernel, count, 0, *arguments)
        return
    size = max(grain, -(-count // (threads * CHUNKS_PER_THREAD)))
    inputs = command_of(kernel, device).describe((0, *arguments))
    # the next piece goes to whoever asks first
    firsts = iter(range(0, count, size))

    def take_pieces() -> None:
        command = command_of(kernel, device)
        command.set_arguments(inputs)
        for first in firsts:
            command.set_argument(0, first)
            command.run(min(size, count - first))

    helpers = [_pool(threads).submit(take_pieces) for _ in range(min(threads, -(-count // size)) - 1)]
    try:
        take_pieces()
    finally:
        # whatever ended this thread's share: the arguments are the helpers' until they are done
        wait(helpers)
    for helper in helpers:
        helper.result()


def warp_array(tensor: Tensor, dtype: Any = None) -> wp.array:
    """A Warp view of a tensor, for `wp.utils` functions, which take arrays rather than descriptors."""
    start_warp()
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """The helpers of the thread that launches: one less than take part."""
    _forget_pools_in_children()
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="samira-warp")


@functools.cache
def _forget_pools_in_children() -> None:
    """A forked process inherits the pools, but not their threads, and would wait for those for ever."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_pool.cache_clear)


def _device_of(arguments: tuple[Any, ...]) -> torch.device:
    for argument in arguments:
        if isinstance(argument, Tensor):
            return argument.device
    raise TypeError("a launch needs at least one tensor argument to tell its device")
