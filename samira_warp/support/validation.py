"""Checks of tensors at the public boundary; kernels behind it assume."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import torch
from torch import Tensor

from samira_warp.support.errors import UserError

FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""The dtypes of numbers that an operator converts itself."""

INTEGERS = (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)
"""The dtypes of ids that an operator converts itself."""

Shape = Sequence[int | str]
"""An entry per dimension: a number, or a name such as "N", which means one number throughout a check."""

Dtype = torch.dtype | tuple[torch.dtype, ...] | None
"""The dtype, any of several, or any at all."""

Wanted = tuple[str, Tensor, Shape] | tuple[str, Tensor, Shape, Dtype]
"""An argument's name, what came, and what it should be; float32 where nothing else is said."""

_KERNELS_RUN_ON = ("cpu", "cuda")


def check_tensors(*wanted: Wanted, device: torch.device | None = None) -> None:
    """Raise UserError unless all tensors have the shapes and dtypes that are asked for, on one device.

    A size's name means the same number in every shape: the first tensor that has it says which.

    Args:
        *wanted: A row for each tensor.
        device: Where they must be; None for where the first one is, if kernels run there.
    """
    sizes: dict[str, int] = {}
    for index, (name, tensor, shape, *rest) in enumerate(wanted):
        dtype = rest[0] if rest else torch.float32
        if isinstance(tensor, Tensor):
            place = tensor.device
            if device is None and place.type in _KERNELS_RUN_ON:
                device = place
            fits = place == device and (tensor.dtype is dtype or _is_one_of(tensor.dtype, dtype))
            if fits and _has_shape(tensor, shape, sizes):
                continue
        _refuse(name, tensor, _known(shape, wanted[:index]), dtype, device)


def check_tensor(
    name: str,
    tensor: Tensor,
    *,
    shape: Shape,
    dtype: Dtype = torch.float32,
    device: torch.device | None = None,
) -> None:
    """Raise UserError unless ``tensor`` has the shape, dtype and device that are asked for.

    Args:
        name: The argument's name, for the message.
        tensor: What came.
        shape: What its shape should be.
        dtype: What its dtype should be.
        device: The device expected, or None for any that kernels run on.
    """
    check_tensors((name, tensor, shape, dtype), device=device)


def check_ids(
    name: str, ids: Tensor, *, shape: Shape, count: int, device: torch.device | None = None
) -> None:
    """Raise UserError unless ``ids`` are integers from 0 to ``count`` - 1; waits for a GPU.

    Args:
        name: The argument's name, for the message.
        ids: What came.
        shape: What its shape should be.
        count: Number of things that have ids.
        device: The device expected, or None for any that kernels run on.
    """
    check_tensor(name, ids, shape=shape, dtype=INTEGERS, device=device)
    if ids.numel():
        least, greatest = (int(bound) for bound in torch.aminmax(ids))
        if least < 0 or greatest >= count:
            raise UserError(name, expected=f"ids 0 to {count - 1}", found=f"{least} to {greatest}")


def _has_shape(tensor: Tensor, shape: Shape, sizes: dict[str, int]) -> bool:
    """Whether the shape fits; notes what the names in it stand for, where it is the first to have them."""
    found = tensor.shape
    if found == shape:
        return True
    if len(found) != len(shape):
        return False
    for size, want in zip(found, shape, strict=True):
        if size != want and (isinstance(want, int) or sizes.setdefault(want, size) != size):
            return False
    return True


def _is_one_of(found: torch.dtype, dtype: Dtype) -> bool:
    return dtype is None or (isinstance(dtype, tuple) and found in dtype)


def _known(shape: Shape, earlier: Sequence[Wanted]) -> Shape:
    """The shape with numbers for the names that the tensors before have settled."""
    sizes: dict[int | str, int] = {}
    for _, tensor, names, *_ in earlier:
        sizes.update(zip(names, tensor.shape, strict=True))
    return tuple(sizes.get(want, want) if isinstance(want, str) else want for want in shape)


def _refuse(name: str, tensor: object, shape: Shape, dtype: Dtype, device: torch.device | None) -> NoReturn:
    """Say what was expected and what came."""
    dimensions = ", ".join(map(str, shape))
    expected = f"{_dtype_name(dtype)} tensor of shape ({dimensions})"
    if not isinstance(tensor, Tensor):
        found = type(tensor).__name__
    else:
        found = f"{_dtype_name(tensor.dtype)} {tuple(tensor.shape)} on {tensor.device}"
        if tensor.device != device:
            expected += f" on {device or ' or '.join(_KERNELS_RUN_ON)}"
    raise UserError(name, expected=expected, found=found)


def _dtype_name(dtype: Dtype) -> str:
    if dtype is None:
        return "any"
    if dtype is FLOATS or dtype is INTEGERS:
        return "floating" if dtype is FLOATS else "integer"
    return " or ".join(
        str(one).removeprefix("torch.") for one in (dtype if isinstance(dtype, tuple) else (dtype,))
    )
