"""Peak memory of a call: bytes of the tensors that it made, counted while it runs."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves


def peak_bytes(function: Callable[[], object], device: torch.device) -> int:
    """Most bytes at once of the tensors that ``function`` makes, above what was alive before.

    Its result counts while it runs. On a GPU the allocator's own account; on a CPU every tensor's storage,
    from the operation that makes it until its last owner is gone.
    """
    if device.type == "cuda":
        torch.cuda.synchronize(device)
        before = torch.cuda.memory_allocated(device)
        torch.cuda.reset_peak_memory_stats(device)
        function()
        torch.cuda.synchronize(device)
        return torch.cuda.max_memory_allocated(device) - before
    with _StorageCounter() as counter:
        function()
    return counter.peak


class _StorageCounter(TorchDispatchMode):
    """Follows the storages of all tensors that torch's operations make."""

    def __init__(self) -> None:
        super().__init__()
        self.peak = 0
        self._alive = 0
        self._seen = weakref.WeakSet[torch.UntypedStorage]()

    def __torch_dispatch__(
        self,
        operation: Callable[..., Any],
        types: Any,
        arguments: tuple[Any, ...] = (),
        options: dict[str, Any] | None = None,
    ) -> Any:
        # what an operation returns is new unless it came in: views and results in place share their storage
        self._seen.update(_storages((arguments, options)))
        result = operation(*arguments, **(options or {}))
        for storage in _storages(result):
            if storage not in self._seen:
                self._seen.add(storage)
                self._count(storage.nbytes())
                weakref.finalize(storage, self._count, -storage.nbytes())
        return result

    def _count(self, size: int) -> None:
        self._alive += size
        self.peak = max(self.peak, self._alive)


def _storages(values: Any) -> list[torch.UntypedStorage]:
    return [value.untyped_storage() for value in tree_leaves(values) if isinstance(value, Tensor)]
