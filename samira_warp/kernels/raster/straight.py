"""From blended sums to the straight surface of every pixel, in one pass, with its adjoint in another.

What is blended is premultiplied. A pixel's channels are its sums over its coverage, and directions are
normalised; each goes to an array of its own, as deferred shading reads it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors
from samira_warp.surface import CHANNELS, LIGHT_WIDTH, SURFACE_WIDTH, Surface

GRAIN = 4096
"""Pixels that are worth a thread."""

_SURFACE_WIDTH = wp.constant(SURFACE_WIDTH)

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
        sums: (H, W, C) float32: the surface's own channels side by side in the table's order
            (`samira_warp.surface`), those of light likewise or left out, and depth.
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
    *channels, depth = _Straighten.apply(sums, alpha)
    return Straight(Surface(**dict(zip(CHANNELS, channels, strict=True))), depth)


class _Straighten(torch.autograd.Function):
    """Per pixel; one output a channel, and depth last."""

    @staticmethod
    def forward(ctx: Any, sums: Tensor, alpha: Tensor) -> tuple[Tensor, ...]:
        sums, alpha = sums.contiguous(), alpha.contiguous()
        widths = [*(channel.width for channel in CHANNELS.values()), 1]
        outputs = [sums.new_empty(*alpha.shape, width) for width in widths]
        pixels = sums.view(-1, sums.shape[2]), alpha.view(-1)
        launch_range(_straighten, alpha.numel(), *pixels, *map(_by_pixel, outputs), grain=GRAIN)
        ctx.save_for_backward(sums, alpha)
        return tuple(outputs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, Tensor]:
        sums, alpha = ctx.saved_tensors
        grad_sums, grad_alpha = torch.empty_like(sums), torch.empty_like(alpha)
        pixels = sums.view(-1, sums.shape[2]), alpha.view(-1)
        grads = (_by_pixel(grad.contiguous()) for grad in upstream)
        launch_range(
            _straighten_adjoint,
            alpha.numel(),
            *pixels,
            *grads,
            grad_sums.view(-1, sums.shape[2]),
            grad_alpha.view(-1),
            grain=GRAIN,
        )
        return grad_sums, grad_alpha


def _by_pixel(values: Tensor) -> Tensor:
    """(H, W, 3) as (M, 3), and (H, W, 1) as (M,)."""
    return values.view(-1) if values.shape[-1] == 1 else values.view(-1, values.shape[-1])


@wp.func
def _three(rows: wp.array2d[wp.float32], p: wp.int32, column: wp.int32) -> wp.vec3:
    return wp.vec3(rows[p, column], rows[p, column + 1], rows[p, column + 2])


@wp.kernel(enable_backward=False)
def _straighten(
    first: wp.int32,
    sums: wp.array2d[wp.float32],
    alpha: wp.array[wp.float32],
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response_diffuse: wp.array[wp.float32],
    response_specular: wp.array[wp.float32],
    visibility: wp.array[wp.vec3],
    visibility_specular: wp.array[wp.float32],
    ambient_occlusion: wp.array[wp.float32],
    depth: wp.array[wp.float32],
) -> None:
    """The channels of one pixel."""
    p = first + wp.tid()
    share = wp.max(alpha[p], _COVERED)

    # ---- The surface's own.
    albedo[p] = _three(sums, p, 0) / share
    direction = _three(sums, p, 3) / share
    normal[p] = direction / wp.max(wp.length(direction), _LEAST_LENGTH)
    roughness[p] = sums[p, 6] / share
    specular[p] = sums[p, 7] / share
    response_diffuse[p] = sums[p, 8] / share
    response_specular[p] = sums[p, 9] / share
    depth[p] = sums[p, sums.shape[1] - 1] / share

    # ---- What of the light arrives.
    if alpha[p] >= _COVERED and sums.shape[1] > _SURFACE_WIDTH + 1:
        visibility[p] = _three(sums, p, 10) / share
        visibility_specular[p] = sums[p, 13] / share
        ambient_occlusion[p] = sums[p, 14] / share
    else:
        visibility[p] = wp.vec3(1.0)
        visibility_specular[p] = 1.0
        ambient_occlusion[p] = 1.0


@wp.kernel(enable_backward=False)
def _straighten_adjoint(
    first: wp.int32,
    sums: wp.array2d[wp.float32],
    alpha: wp.array[wp.float32],
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response_diffuse: wp.array[wp.float32],
    response_specular: wp.array[wp.float32],
    visibility: wp.array[wp.vec3],
    visibility_specular: wp.array[wp.float32],
    ambient_occlusion: wp.array[wp.float32],
    depth: wp.array[wp.float32],
    grad_sums: wp.array2d[wp.float32],
    grad_alpha: wp.array[wp.float32],
) -> None:
    """Adjoint of one pixel's; the channels' parameters are what came to them.

    With y = s / a, ds = dy / a and da = -y . dy / a, which is -s . ds / a for all channels at once. A
    direction does not change with a.
    """
    p = first + wp.tid()
    share = wp.max(alpha[p], _COVERED)
    last = sums.shape[1] - 1
    covered = alpha[p] >= _COVERED

    # ---- The surface's own.
    by_albedo = albedo[p] / share
    for k in range(3):
        grad_sums[p, k] = by_albedo[k]
    grad_sums[p, 6] = roughness[p] / share
    grad_sums[p, 7] = specular[p] / share
    grad_sums[p, 8] = response_diffuse[p] / share
    grad_sums[p, 9] = response_specular[p] / share
    grad_sums[p, last] = depth[p] / share

    # ---- What of the light arrives; where next to nothing covers the pixel it was 1.
    if last > _SURFACE_WIDTH:
        by_visibility = wp.vec3()
        by_specular = wp.float32(0.0)
        by_occlusion = wp.float32(0.0)
        if covered:
            by_visibility = visibility[p] / share
            by_specular = visibility_specular[p] / share
            by_occlusion = ambient_occlusion[p] / share
        for k in range(3):
            grad_sums[p, 10 + k] = by_visibility[k]
        grad_sums[p, 13] = by_specular
        grad_sums[p, 14] = by_occlusion

    # ---- Coverage, of all but the direction.
    total = wp.float32(0.0)
    if covered:
        for k in range(3):
            total += sums[p, k] * grad_sums[p, k]
        for k in range(6, last + 1):
            total += sums[p, k] * grad_sums[p, k]
    grad_alpha[p] = -total / share

    # ---- The direction u = s / |s|: what is along u is lost. Below the least length it is s over that.
    direction = _three(sums, p, 3) / share
    length = wp.length(direction)
    by_direction = normal[p]
    if length > _LEAST_LENGTH:
        unit = direction / length
        by_direction -= wp.dot(unit, by_direction) * unit
    by_direction /= wp.max(length, _LEAST_LENGTH) * share
    for k in range(3):
        grad_sums[p, 3 + k] = by_direction[k]
