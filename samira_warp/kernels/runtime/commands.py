"""Recorded launches: recorded once by each thread, and replayed with other arguments.

At an avatar's sizes a kernel often runs for less time than Warp takes to look at its arguments, which a
replay does not do again.
"""

from __future__ import annotations

import copy
import ctypes
import functools
import threading
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime.loading import load
from samira_warp.kernels.runtime.streams import current_stream

_own = threading.local()
"""Each thread's commands, which end with it: two threads must not set one command's arguments."""


class Command:
    """A recorded launch of a kernel on one device, by one thread.

    Warp checks a parameter's first tensor in full; later ones of the same layout only need their address,
    shape and strides. No tensor is held on to: the caller keeps a launch's arguments until it has run.

    Attributes:
        kernel: What is launched.
    """

    def __init__(self, kernel: wp.Kernel, device: torch.device, block_dim: int | None) -> None:
        self._parameters = kernel.adj.args
        self._layouts: list[_Layout | None] = [None] * len(self._parameters)
        self._descriptors: list[tuple[torch.Size, Any]] = [(torch.Size(), None)] * len(self._parameters)
        self._options: dict[str, Any] = {
            "device": str(device),
            **({} if block_dim is None else {"block_dim": block_dim}),
        }
        self.kernel, self._device = kernel, device
        # the recorded launch, from the first arguments on
        self._launch: Any = None
        self._dim: int | tuple[int, ...] = 1

    def describe(self, arguments: tuple[Any, ...]) -> list[Any]:
        """Arguments as the launch takes them: array descriptors for tensors, other values as they are."""
        if len(arguments) != len(self._parameters):
            raise TypeError(
                f"{self.kernel.key} takes {len(self._parameters)} arguments, not {len(arguments)}"
            )
        return [
            self._describe(index, argument) if isinstance(argument, Tensor) else argument
            for index, argument in enumerate(arguments)
        ]

    def set_arguments(self, described: list[Any]) -> None:
        """Take what `describe` returned, of any thread's command for this kernel."""
        if self._launch is None:
            # later arguments are written into these very objects, which therefore have to be the command's
            # own
            own = [copy.copy(value) if isinstance(value, ctypes.Array) else value for value in described]
            self._launch = wp.launch(self.kernel, self._dim, inputs=own, record_cmd=True, **self._options)
            return
        for index, value in enumerate(described):
            self._launch.set_param_at_index_from_ctype(index, value)

    def set_argument(self, index: int, value: int) -> None:
        """Replace one number."""
        self._launch.set_param_at_index_from_ctype(index, value)

    def run(self, dim: int | tuple[int, ...]) -> None:
        """Launch over ``dim``, on a GPU in torch's current stream."""
        if dim != self._dim:
            self._launch.set_dim(dim)
            self._dim = dim
        self._launch.launch(stream=current_stream(self._device) if self._device.type == "cuda" else None)

    def _describe(self, index: int, tensor: Tensor) -> Any:
        layout = self._layouts[index]
        shape = tensor.shape
        if (
            layout is None
            or tensor.dtype is not layout.dtype
            or shape[layout.dimensions :] != layout.element
            or not tensor.is_contiguous()
        ):
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
        return descriptor

    def _learn(self, index: int, tensor: Tensor) -> Any:
        """Warp's own conversion, with its checks, and its layout for the next time."""
        kind = self._parameters[index].type
        descriptor = wp.from_torch(tensor.detach(), dtype=kind.dtype, return_ctype=True, requires_grad=False)
        if descriptor.ndim == kind.ndim and tensor.is_contiguous():
            element = tensor.shape[kind.ndim :]
            self._layouts[index] = _Layout(
                tensor.dtype, kind.ndim, element, tensor.element_size() * element.numel()
            )
        # without the reference to the tensor that Warp adds
        return type(descriptor).from_buffer_copy(descriptor)


class _Layout(NamedTuple):
    """What the fast path expects of a tensor: the array's ``dimensions``, then the shape of its elements."""

    dtype: torch.dtype
    dimensions: int
    element: torch.Size
    element_bytes: int


def command_of(kernel: wp.Kernel, device: torch.device, block_dim: int | None = None) -> Command:
    """This thread's command for a kernel, whose module is compiled and loaded where it was not."""
    commands: dict[tuple[Any, ...], Command] = _own.__dict__.setdefault("commands", {})
    key = (kernel, device, block_dim)
    if key not in commands:
        load(kernel.module, device, block_dim)
        commands[key] = Command(kernel, device, block_dim)
    return commands[key]


@functools.cache
def _descriptor_type() -> type:
    """Warp's array descriptor, a ctypes structure."""
    return type(wp.from_torch(torch.zeros(1), return_ctype=True))
