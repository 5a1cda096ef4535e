"""From blended sums to the straight surface of every pixel, in one pass, with its adjoint in another.

What is blended is premultiplied. A pixel's channels are its sums over its coverage, and directions are
normalised; each goes to an array of its own, as deferred shading reads it. Which columns are which channel is
the table's to say (`samira_warp.surface`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.caching import cached_tensors
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors
from samira_warp.surface import (
    CHANNELS,
    LIGHT_CHANNELS,
    LIGHT_WIDTH,
    SURFACE_CHANNELS,
    SURFACE_WIDTH,
    Surface,
)

GRAIN = 4096
"""Pixels that are worth a thread."""

_MEAN, _DIRECTION, _SHARE = wp.constant(0), wp.constant(1), wp.constant(2)
"""What becomes of a column: a mean; the first of a direction's three; a share of the light, which is 1 where
next to nothing covers a pixel."""

_COVERED = wp.constant(COVERED_ALPHA)

_LEAST_LENGTH = wp.constant(1e-12)
"""Of a sum that is divided by its length; a shorter one is no direction (`torch.nn.functional.normalize`)."""


class Straight(NamedTuple):
    """What of a surface is in every pixel.

    Attributes:
        surface: Channels (H, W, width); directions are of unit length, or zero where a pixel shows nothing.
        depth: (H, W, 1), in the unit in which it was blended.
    """

    surface: Surface
    depth: Tensor


def straighten(sums: Tensor, alpha: Tensor) -> Straight:
    """Divide blended sums by their coverage, or by 1/255 where it is less.

    Args:
        sums: (H, W, C) float32: the surface's own channels side by side in the table's order, those of light
            likewise or left out, and depth.
        alpha: (H, W) float32 coverage.

    Returns:
        The channels, differentiable in both. Those of light are 1 where next to nothing covers a pixel, and
        everywhere if they were left out.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_tensors(
        ("sums", sums, ("H", "W", "C")), ("alpha", alpha, tuple(sums.shape[:2])), device=sums.device
    )
    widths = (SURFACE_WIDTH + 1, SURFACE_WIDTH + LIGHT_WIDTH + 1)
    if sums.shape[2] not in widths:
        raise UserError(
            "sums", expected=f"{widths[0]} channels, or {widths[1]} with light", found=sums.shape[2]
        )
    lit = sums.shape[2] == widths[1]
    *channels, depth = _Straighten.apply(sums, alpha, lit)
    return Straight(Surface.of(**dict(zip(_names(lit), channels, strict=True))), depth)


class _Straighten(torch.autograd.Function):
    """Per pixel; one output a channel, and depth last."""

    @staticmethod
    def forward(ctx: Any, sums: Tensor, alpha: Tensor, lit: bool) -> tuple[Tensor, ...]:
        sums, alpha = sums.contiguous(), alpha.contiguous()
        values = sums.new_empty(sums.numel())
        pixels = sums.view(-1, sums.shape[2]), alpha.view(-1), _columns(lit, sums.device)
        launch_range(_straighten, alpha.numel(), *pixels, values, grain=GRAIN)
        ctx.save_for_backward(sums, alpha)
        ctx.lit = lit
        widths = [*(CHANNELS[name].width for name in _names(lit)), 1]
        parts = values.split([alpha.numel() * width for width in widths])
        return tuple(part.view(*alpha.shape, width) for part, width in zip(parts, widths, strict=True))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, Tensor, None]:
        sums, alpha = ctx.saved_tensors
        grad_sums, grad_alpha = torch.empty_like(sums), torch.empty_like(alpha)
        pixels = sums.view(-1, sums.shape[2]), alpha.view(-1), _columns(ctx.lit, sums.device)
        came = torch.cat([grad.reshape(-1) for grad in upstream])
        grads = grad_sums.view(-1, sums.shape[2]), grad_alpha.view(-1)
        launch_range(_straighten_adjoint, alpha.numel(), *pixels, came, *grads, grain=GRAIN)
        return grad_sums, grad_alpha, None


def _names(lit: bool) -> list[str]:
    return [*SURFACE_CHANNELS, *(LIGHT_CHANNELS if lit else ())]


@cached_tensors()
def _columns(lit: bool, device: torch.device) -> Tensor:
    """(C, 4) int32: what becomes of each column, its channel's first column and width, its place in it."""
    rows, first = [], 0
    for channel in (*(CHANNELS[name] for name in _names(lit)), None):
        width = 1 if channel is None else channel.width
        kind = _MEAN
        if channel is not None and channel.of == "light":
            kind = _SHARE
        elif channel is not None and channel.blend == "direction":
            kind = _DIRECTION
        rows += [[int(kind), first, width, place] for place in range(width)]
        first += width
    return torch.tensor(rows, dtype=torch.int32, device=device)


@wp.func
def _three(rows: wp.array2d[wp.float32], p: wp.int32, column: wp.int32) -> wp.vec3:
    return wp.vec3(rows[p, column], rows[p, column + 1], rows[p, column + 2])


@wp.func
def _at(columns: wp.array2d[wp.int32], column: wp.int32, p: wp.int32, pixels: wp.int32) -> wp.int32:
    """Where a pixel's value of a column stands: channel by channel, each pixel by pixel."""
    return columns[column, 1] * pixels + p * columns[column, 2] + columns[column, 3]


@wp.kernel(enable_backward=False)
def _straighten(
    first: wp.int32,
    sums: wp.array2d[wp.float32],
    alpha: wp.array[wp.float32],
    columns: wp.array2d[wp.int32],
    values: wp.array[wp.float32],
) -> None:
    """The channels of one pixel."""
    p = first + wp.tid()
    share = wp.max(alpha[p], _COVERED)
    pixels = alpha.shape[0]
    column = wp.int32(0)
    while column < sums.shape[1]:
        at = _at(columns, column, p, pixels)
        if columns[column, 0] == _DIRECTION:
            direction = _three(sums, p, column) / share
            direction /= wp.max(wp.length(direction), _LEAST_LENGTH)
            for k in range(3):
                values[at + k] = direction[k]
            column += 3
        else:
            value = sums[p, column] / share
            if columns[column, 0] == _SHARE and alpha[p] < _COVERED:
                value = wp.float32(1.0)
            values[at] = value
            column += 1


@wp.kernel(enable_backward=False)
def _straighten_adjoint(
    first: wp.int32,
    sums: wp.array2d[wp.float32],
    alpha: wp.array[wp.float32],
    columns: wp.array2d[wp.int32],
    came: wp.array[wp.float32],
    grad_sums: wp.array2d[wp.float32],
    grad_alpha: wp.array[wp.float32],
) -> None:
    """Adjoint of one pixel's; ``came`` is what came to its values, as they lie.

    With y = s / a, ds = dy / a and da = -y . dy / a, which is -s . ds / a for all columns at once. Of a
    direction u = s / |s| what is along u is lost, and it does not change with a; below the least length it is
    s over that.
    """
    p = first + wp.tid()
    share = wp.max(alpha[p], _COVERED)
    pixels = alpha.shape[0]
    covered = alpha[p] >= _COVERED
    total = wp.float32(0.0)
    column = wp.int32(0)
    while column < sums.shape[1]:
        at = _at(columns, column, p, pixels)
        if columns[column, 0] == _DIRECTION:
            direction = _three(sums, p, column) / share
            length = wp.length(direction)
            grad = wp.vec3(came[at], came[at + 1], came[at + 2])
            if length > _LEAST_LENGTH:
                unit = direction / length
                grad -= wp.dot(unit, grad) * unit
            grad /= wp.max(length, _LEAST_LENGTH) * share
            for k in range(3):
                grad_sums[p, column + k] = grad[k]
            column += 3
        else:
            by_sum = came[at] / share
            if columns[column, 0] == _SHARE and not covered:
                by_sum = wp.float32(0.0)
            grad_sums[p, column] = by_sum
            total += sums[p, column] * by_sum
            column += 1
    # where coverage is below the least, sums are divided by that instead
    grad_alpha[p] = wp.where(covered, -total / share, 0.0)
