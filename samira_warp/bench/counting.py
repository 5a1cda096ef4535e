"""What a piece of work asks of a GPU: launches of Warp, operations of torch, and waits for their results.

A launch costs the host microseconds, however little it computes, and a wait keeps the host from queueing what
comes next. Both can be counted without a GPU.
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from samira_warp.kernels.runtime.commands import Command

UTILITIES = ("radix_sort_pairs",)
"""Functions of `warp.utils` that launch; all that the package uses."""

ALLOCATIONS = ("empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided", "resize_", "set_")
"""Operations of torch that give memory and compute nothing."""

WAITS = {
    "_local_scalar_dense": "a value read",
    "equal": "a value read",
    "nonzero": "a size read",
    "masked_select": "a size read",
    "_unique2": "a size read",
    "unique_dim": "a size read",
    "unique_consecutive": "a size read",
    "bincount": "a size read",
}
"""Operations of torch that on a GPU return once it has computed: ``item()``, ``float()``, ``bool()`` and
``if`` are the first."""

COPIES = ("_to_copy", "copy_")
"""Operations of torch that may copy between a GPU and its host."""

MASKED = ("index", "_unsafe_index", "index_put", "index_put_", "_index_put_impl_")
"""Operations that have to know how many entries a mask has, where one is among their indices."""

_SYNC_WARNING = "called a synchronizing CUDA operation"
"""How the warning of ``torch.cuda.set_sync_debug_mode`` begins."""

_PACKAGE = Path(__file__).resolve().parents[1]

_NOT_THE_CALLER = (str(Path(torch.__file__).parent) + os.sep, __file__)


class Wait(NamedTuple):
    """Something that the host waits for.

    Attributes:
        why: What it wants to know.
        operation: Torch's name of what waits.
        where: File and line, or the adjoint that waits in a backward pass.
    """

    why: str
    operation: str
    where: str


@dataclass
class Counts:
    """What was counted of one stage.

    Attributes:
        launches: How often each Warp kernel, or utility of Warp, was launched.
        operations: How often each operation of torch ran that computes: no views, no memory alone, and
            nothing without a number in it. On a GPU each is one kernel or a few.
        waits: How often the host had to wait for each.
        warned: How often CUDA itself told of a wait; None on a CPU.
    """

    launches: Counter[str] = field(default_factory=Counter)
    operations: Counter[str] = field(default_factory=Counter)
    waits: Counter[Wait] = field(default_factory=Counter)
    warned: int | None = None


class WorkCounter:
    """Counts the work of named stages within a ``with`` block; of nested stages, for the inner one.

    On a CPU what is counted is what its own code does, on one thread, where a range of indices is a single
    launch as on a GPU. What a GPU would be waited for is told by what is called: reads of values and sizes,
    ``cpu()``, ``tolist()``, ``to("cpu")``, and tensors made of Python's numbers for a device that is named.
    Work on tensors that would be the host's own there counts as well; copies to where a tensor already is
    cannot be seen. On a GPU only what concerns its tensors is counted, and all copies are seen.

    Attributes:
        counts: What was counted, by stage in the order of their beginnings.
    """

    def __init__(self, device: torch.device) -> None:
        self.counts: dict[str, Counts] = {}
        self._device = device
        self._stage: str | None = None
        self._entered = contextlib.ExitStack()
        self._warned: list[warnings.WarningMessage] = []

    def __enter__(self) -> WorkCounter:
        """Begin."""
        with contextlib.ExitStack() as stack:
            if self._device.type == "cuda":
                self._warned = stack.enter_context(_told_by_cuda())
            else:
                stack.callback(torch.set_num_threads, torch.get_num_threads())
                torch.set_num_threads(1)
                stack.enter_context(_HostCopies(self))
            stack.enter_context(_launches_told(self._launched))
            stack.enter_context(_Operations(self, self._device))
            self._entered = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave everything as it was."""
        self._entered.close()

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is inside for a stage."""
        outer, self._stage = self._stage, name
        counts, before = self.counts.setdefault(name, Counts()), len(self._warned)
        try:
            yield
        finally:
            self._stage = outer
            if self._device.type == "cuda":
                told = [str(each.message) for each in self._warned[before:]]
                counts.warned = (counts.warned or 0) + sum(_SYNC_WARNING in text for text in told)

    def computed(self, operation: str) -> None:
        """Count an operation of torch."""
        if self._stage is not None:
            self.counts[self._stage].operations[operation] += 1

    def waited(self, why: str, operation: str) -> None:
        """Count a wait, which whoever called torch asked for."""
        if self._stage is not None:
            self.counts[self._stage].waits[Wait(why, operation, _caller())] += 1

    def _launched(self, kernel: str) -> None:
        if self._stage is not None:
            self.counts[self._stage].launches[kernel] += 1


class _Operations(TorchDispatchMode):
    """Tells of torch's operations as they reach a device."""

    def __init__(self, counter: WorkCounter, device: torch.device) -> None:
        super().__init__()
        self._counter, self._on_gpu = counter, device.type == "cuda"

    def __torch_dispatch__(
        self,
        operation: Any,
        types: Any,
        arguments: tuple[Any, ...] = (),
        options: dict[str, Any] | None = None,
    ) -> Any:
        given = options or {}
        result = operation(*arguments, **given)
        inputs, outputs = _tensors((arguments, given)), _tensors(result)
        if not self._on_gpu or any(tensor.is_cuda for tensor in inputs + outputs):
            name = operation.overloadpacket.__name__
            if name in COPIES:
                why = None if _does_not_wait(name, arguments, given) else _copy(inputs, outputs)
            else:
                why = _wait(name, arguments, given)
            if why is not None:
                self._counter.waited(why, name)
            if _computes(name, operation, inputs, outputs):
                self._counter.computed(name)
        return result


class _HostCopies(TorchFunctionMode):
    """Tells of copies to and from the host that on a CPU copy nothing, and are no operations therefore."""

    def __init__(self, counter: WorkCounter) -> None:
        super().__init__()
        self._counter = counter

    def __torch_function__(
        self,
        function: Any,
        types: Any,
        arguments: tuple[Any, ...] = (),
        options: dict[str, Any] | None = None,
    ) -> Any:
        given = options or {}
        name = getattr(function, "__name__", "")
        if function in (Tensor.cpu, Tensor.tolist) or (function is Tensor.to and _to_host(arguments, given)):
            self._counter.waited("a copy to the host", name)
        elif function in (torch.tensor, torch.as_tensor) and given.get("device") is not None:
            self._counter.waited("a copy from the host", name)
        return function(*arguments, **given)


def _to_host(arguments: tuple[Any, ...], options: dict[str, Any]) -> bool:
    """Whether ``Tensor.to`` is told "cpu" in so many words: a `torch.device` is that of the work."""
    named = arguments[1] if len(arguments) > 1 else options.get("device")
    return isinstance(named, str) and named == "cpu"


def _tensors(values: Any) -> list[Tensor]:
    return [value for value in tree_leaves(values) if isinstance(value, Tensor)]


def _computes(name: str, operation: Any, inputs: list[Tensor], outputs: list[Tensor]) -> bool:
    """Whether an operation writes numbers: into what it was given, or into memory of its own."""
    if name in ALLOCATIONS:
        return False
    if operation._schema.is_mutable:
        return True
    known = {tensor.untyped_storage().data_ptr() for tensor in inputs}
    return any(tensor.numel() > 0 and tensor.untyped_storage().data_ptr() not in known for tensor in outputs)


def _wait(name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> str | None:
    """What an operation waits for on a GPU by itself."""
    if name == "repeat_interleave" and isinstance(arguments[0], Tensor):
        return "a size read" if options.get("output_size") is None else None
    if name in MASKED:
        masks = [each for each in _tensors(arguments[1]) if each.dtype in (torch.bool, torch.uint8)]
        # one mask and one number of the host's are a masked fill
        fills = "put" in name and len(masks) == 1 and arguments[2].dim() == 0 and not arguments[2].is_cuda
        return "a size read" if masks and not fills else None
    return WAITS.get(name)


def _does_not_wait(name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> bool:
    """Whether one of `COPIES` is asked not to block."""
    return bool(options.get("non_blocking") or (name == "copy_" and len(arguments) > 2 and arguments[2]))


def _copy(inputs: list[Tensor], outputs: list[Tensor]) -> str | None:
    """Which way one of `COPIES` copies between a GPU and its host."""
    source, target = inputs[-1].is_cuda, outputs[0].is_cuda
    if source == target:
        return None
    return "a copy to the host" if source else "a copy from the host"


def _caller() -> str:
    """Who called torch: file and line, or the adjoint that torch computes by itself."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_NOT_THE_CALLER):
        frame = frame.f_back
    path = Path(frame.f_code.co_filename)
    inside = path.is_relative_to(_PACKAGE)
    node = torch._C._current_autograd_node()
    if node is not None and (not inside or path.parent.name == "bench"):
        return f"the adjoint {node.name()}"
    return f"{path.relative_to(_PACKAGE).as_posix() if inside else path.name}:{frame.f_lineno}"


@contextlib.contextmanager
def _launches_told(tell: Callable[[str], None]) -> Iterator[None]:
    """Tell of every launch of Warp, by any thread, by the kernel's name."""
    launch = Command.run

    def run(command: Command, dim: int | tuple[int, ...]) -> None:
        tell(command.kernel.key)
        launch(command, dim)

    with contextlib.ExitStack() as stack:
        stack.enter_context(_replaced(Command, "run", run))
        for name in UTILITIES:
            stack.enter_context(_replaced(wp.utils, name, _told(getattr(wp.utils, name), name, tell)))
        yield


def _told(function: Callable[..., Any], name: str, tell: Callable[[str], None]) -> Callable[..., Any]:
    def call(*arguments: Any, **options: Any) -> Any:
        tell(name)
        return function(*arguments, **options)

    return call


@contextlib.contextmanager
def _replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """An attribute with another value."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextlib.contextmanager
def _told_by_cuda() -> Iterator[list[warnings.WarningMessage]]:
    """Have CUDA warn of every wait that torch knows of, into a list, and show what else was warned of."""
    before = torch.cuda.get_sync_debug_mode()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            yield told
        finally:
            torch.cuda.set_sync_debug_mode(before)
    for each in told:
        if _SYNC_WARNING not in str(each.message):
            warnings.showwarning(each.message, each.category, each.filename, each.lineno)
