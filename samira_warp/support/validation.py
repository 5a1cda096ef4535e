"""Checks of tensors at the public boundary; kernels behind it assume."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.support.errors import UserError


def check_tensor(
    name: str,
    tensor: Tensor,
    *,
    shape: tuple[int | str, ...],
    dtype: torch.dtype | None = torch.float32,
    device: torch.device | None = None,
) -> None:
    """Raise UserError unless ``tensor`` has the shape, dtype and device that are asked for.

    Args:
        name: The argument's name, for the message.
        tensor: What came.
        shape: One entry per dimension: a number, or a name such as "N" for any size.
        dtype: The dtype expected, or None for any.
        device: The device expected, or None for any.
    """
    if isinstance(tensor, Tensor):
        if (
            _fits(tensor.shape, shape)
            and (dtype is None or tensor.dtype == dtype)
            and (device is None or tensor.device == device)
        ):
            return
        found = f"{_dtype_name(tensor.dtype)} {tuple(tensor.shape)} on {tensor.device}"
    else:
        found = type(tensor).__name__
    wanted = f"{_dtype_name(dtype)} tensor of shape ({', '.join(map(str, shape))})" + (
        f" on {device}" if device else ""
    )
    raise UserError(name, expected=wanted, found=found)


def _fits(found: torch.Size, wanted: tuple[int | str, ...]) -> bool:
    """Whether sizes are those wanted; operators ask this often, so numbers are compared all at once."""
    if found == wanted:
        return True
    if len(found) != len(wanted):
        return False
    for size, want in zip(found, wanted, strict=True):
        if size != want and not isinstance(want, str):
            return False
    return True


def _dtype_name(dtype: torch.dtype | None) -> str:
    return "any" if dtype is None else str(dtype).removeprefix("torch.")
