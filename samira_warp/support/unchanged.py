"""Results that are kept while the tensors that they were made of stay as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

Made = TypeVar("Made")


class WhileUnchanged(Generic[Made]):
    """The last result, to be made anew when one of its tensors was replaced, moved or written into.

    Parameters are compared by their values: torch's fused optimizers write into them without counting it as a
    change. Keep a result of few and small ones. Other tensors are compared by what torch counts; what is
    written into them behind its back, through ``data``, is not seen. A result made without gradients has
    none: keep one only where gradients are off.
    """

    def __init__(self) -> None:
        self._kept: tuple[list[_Then], Made] | None = None

    def get(self, of: Iterable[Tensor], make: Callable[[], Made]) -> Made:
        """What ``make`` makes of tensors, which are always as many, in one order.

        Of tensors that count no changes, those of `torch.inference_mode`, nothing is kept.
        """
        tensors, kept = list(of), self._kept
        if any(tensor.is_inference() for tensor in tensors):
            return make()
        if kept is not None and all(then.is_now(now) for then, now in zip(kept[0], tensors, strict=True)):
            return kept[1]
        thens = [_Then(tensor) for tensor in tensors]
        made = make()
        # one assignment: another thread finds the old result or the new one
        self._kept = thens, made
        return made


class _Then:
    """A tensor as it was."""

    def __init__(self, tensor: Tensor) -> None:
        self._tensor, self._address, self._version = tensor, tensor.data_ptr(), tensor._version
        self._values = tensor.detach().clone() if isinstance(tensor, nn.Parameter) else None

    def is_now(self, tensor: Tensor) -> bool:
        if self._values is not None:
            same_kind = (tensor.dtype, tensor.device) == (self._values.dtype, self._values.device)
            return same_kind and torch.equal(self._values, tensor.detach())
        counted = (tensor.data_ptr(), tensor._version) == (self._address, self._version)
        return tensor is self._tensor and counted
