"""Where torch meets Warp: array descriptors, streams, threads and launches.

Every operator in this folder reaches its kernels through `launch` or `launch_range`; nothing else knows about streams or threads.
A launch is recorded once per kernel, device and thread and replayed with other arguments after that: at an avatar's sizes a kernel
often runs for less time than Warp takes to look at its arguments.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import functools
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
import warp as wp

CHUNKS_PER_THREAD = 8
"""A range launch is cut into this many pieces per thread, so that an uneven piece does not leave a core idle."""


def launch(kernel: wp.Kernel, dim: int | tuple[int, ...], *arguments: Any, block_dim: int | None = None) -> None:
    """Run ``kernel`` over ``dim`` on the device, and in the current stream, of its first tensor argument.

    Tensors become array descriptors of the element type that the kernel's signature declares, without copies: they must outlive the
    launch. Other arguments pass through.
    """
    device = _device_of(arguments)
    command = _command(kernel, device, block_dim, threading.get_ident())
    command.set_arguments(command.describe(arguments))
    command.run(dim)


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
    if count == 0:
        return
    device = _device_of(arguments)
    threads = 1 if device.type == "cuda" else torch.get_num_threads()
    if threads == 1 or count <= grain:
        launch(kernel, count, 0, *arguments)
        return
    size = max(grain, -(-count // (threads * CHUNKS_PER_THREAD)))
    inputs = _command(kernel, device, None, threading.get_ident()).describe((0, *arguments))
    firsts = iter(range(0, count, size))

    def take_chunks() -> None:
        command = _command(kernel, device, None, threading.get_ident())
        command.set_arguments(inputs)
        for first in firsts:
            command.set_argument(0, first)
            command.run(min(size, count - first))

    helpers = [_pool(threads).submit(take_chunks) for _ in range(min(threads, -(-count // size)) - 1)]
    take_chunks()
    for helper in helpers:
        helper.result()


@contextlib.contextmanager
def stream_of(device: torch.device) -> Iterator[None]:
    """Make Warp's own utilities (sort) work in torch's current stream of ``device``, captured or not; nothing to do on the CPU."""
    _start()
    if device.type != "cuda":
        yield
        return
    stream = _current_stream(device)
    with wp.ScopedStream(stream, sync_enter=False):
        # Warp has to know of a capture that torch began, or its temporary memory is freed in the middle of it
        captured = torch.cuda.is_current_stream_capturing()
        if captured:
            wp.capture_begin(stream=stream, external=True, force_module_load=False)
        try:
            yield
        finally:
            if captured:
                wp.capture_end(stream=stream)


def warp_array(tensor: torch.Tensor, dtype: Any = None) -> wp.array:
    """A Warp view of a tensor, for `wp.utils` functions, which take arrays rather than descriptors."""
    _start()
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


class _Layout(NamedTuple):
    """What the fast path expects of a tensor argument: ``dimensions`` of the array, and after those the shape of its elements."""

    dtype: torch.dtype
    dimensions: int
    element: torch.Size
    element_bytes: int


class _Command:
    """A recorded launch of a kernel on one device, by one thread.

    Warp checks a parameter's first tensor in full; later ones of the same layout only need their address, shape and strides.
    """

    def __init__(self, kernel: wp.Kernel, device: torch.device, block_dim: int | None) -> None:
        self._parameters = kernel.adj.args
        self._layouts: list[_Layout | None] = [None] * len(self._parameters)
        self._descriptors: list[tuple[torch.Size, Any]] = [(torch.Size(), None)] * len(self._parameters)
        self._options: dict[str, Any] = {"device": str(device), **({} if block_dim is None else {"block_dim": block_dim})}
        self._kernel, self._device = kernel, device
        self._launch: wp.Launch | None = None
        self._dim: int | tuple[int, ...] = 1

    def describe(self, arguments: tuple[Any, ...]) -> list[Any]:
        """Arguments as the launch takes them: tensors as array descriptors, which hold on to them."""
        described = [
            self._describe(index, argument) if isinstance(argument, torch.Tensor) else argument for index, argument in enumerate(arguments)
        ]
        if len(described) != len(self._parameters):
            raise TypeError(f"{self._kernel.key} takes {len(self._parameters)} arguments, not {len(described)}")
        return described

    def set_arguments(self, described: list[Any]) -> None:
        """Take what `describe` returned, of any thread's command for this kernel."""
        if self._launch is None:
            # later arguments are written into these very objects, which therefore have to be the command's own
            own = [copy.copy(value) if isinstance(value, ctypes.Array) else value for value in described]
            self._launch = wp.launch(self._kernel, self._dim, inputs=own, record_cmd=True, **self._options)
            return
        for index, value in enumerate(described):
            self._launch.set_param_at_index_from_ctype(index, value)

    def set_argument(self, index: int, value: int) -> None:
        """Replace one number."""
        self._launch.set_param_at_index_from_ctype(index, value)

    def run(self, dim: int | tuple[int, ...]) -> None:
        """Launch over ``dim``."""
        if dim != self._dim:
            self._launch.set_dim(dim)
            self._dim = dim
        self._launch.launch(stream=_current_stream(self._device) if self._device.type == "cuda" else None)

    def _describe(self, index: int, tensor: torch.Tensor) -> Any:
        layout = self._layouts[index]
        shape = tensor.shape
        if layout is None or tensor.dtype is not layout.dtype or shape[layout.dimensions :] != layout.element or not tensor.is_contiguous():
            return self._learn(index, tensor)
        known_shape, known = self._descriptors[index]
        if known is None or shape != known_shape:
            strides = [layout.element_bytes] * layout.dimensions
            for axis in range(layout.dimensions - 1, 0, -1):
                strides[axis - 1] = strides[axis] * shape[axis]
            known = _descriptor_type()(0, 0, layout.dimensions, shape, strides)
            self._descriptors[index] = shape, known
        descriptor = type(known).from_buffer_copy(known)
        descriptor.data = tensor.data_ptr()
        descriptor._ref = tensor
        return descriptor

    def _learn(self, index: int, tensor: torch.Tensor) -> Any:
        """Warp's own conversion, with its checks, and its layout for the next time."""
        kind = self._parameters[index].type
        descriptor = wp.from_torch(tensor.detach(), dtype=kind.dtype, return_ctype=True, requires_grad=False)
        if descriptor.ndim == kind.ndim and tensor.is_contiguous():
            element = tensor.shape[kind.ndim :]
            self._layouts[index] = _Layout(tensor.dtype, kind.ndim, element, tensor.element_size() * element.numel())
        return descriptor


@functools.cache
def _command(kernel: wp.Kernel, device: torch.device, block_dim: int | None, thread: int) -> _Command:
    """The command of a thread, by its identifier: two threads must not set one command's arguments."""
    del thread
    _load(kernel, str(device), block_dim)
    return _Command(kernel, device, block_dim)


@functools.cache
def _descriptor_type() -> type:
    """Warp's array descriptor, a ctypes structure."""
    return type(wp.from_torch(torch.zeros(1), return_ctype=True))


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
    """The helpers of the thread that launches: one less than take part."""
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="samira-warp")


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
