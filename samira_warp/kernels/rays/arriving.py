"""How much of a light arrives at points past a mesh, from the bits of its directions.

Bits are those of `samira_warp.kernels.rays.occlusion.unblocked`: bit k of word w is 1 where direction
32 w + k is open. A light is its power in each of those directions, radiance times solid angle.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.rays import arriving_cpu
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 128
"""Points that are worth a thread, with some four hundred directions each."""

DIRECTION_GRAIN = 16
"""Directions that are worth a thread, with some thousands of points each."""

WORD = wp.constant(32)


class Irradiance(NamedTuple):
    """Cosine-weighted sums of a light over the directions above M points, power per area.

    Attributes:
        arriving: (M, 3) over the open directions alone.
        unblocked: (M, 3) over all of them; the same bits where all are open.
    """

    arriving: Tensor
    unblocked: Tensor


def arriving_irradiance(bits: Tensor, normals: Tensor, directions: Tensor, powers: Tensor) -> Irradiance:
    """Sum a light over the directions above points, and over those that are open; differentiable in it.

    Args:
        bits: (M, D / 32) int32, which directions are open; a constant.
        normals: (M, 3) float32 unit vectors; constants.
        directions: (D, 3) float32 unit vectors; constants.
        powers: (D, 3) float32, radiance times solid angle.

    Raises:
        UserError: A tensor has another shape, dtype or device.
    """
    _check(bits, normals, directions)
    check_tensors(("powers", powers, (len(directions), 3)), device=bits.device)
    return Irradiance(*_Arriving.apply(bits, normals.detach(), directions.detach(), powers))


def open_shares(bits: Tensor, axes: Tensor, edges: Tensor, directions: Tensor, areas: Tensor) -> Tensor:
    """The shares of K lobes about an axis that are open: directions count by (c - e)^2 within a lobe.

    c is the cosine to the axis, and e that of the lobe's edge, beyond which nothing counts.

    Args:
        bits: (M, D / 32) int32, which directions are open.
        axes: (M, 3) float32 unit vectors.
        edges: (K,) float32, -1 to below 1: wide enough that some direction is within.
        directions: (D, 3) float32 unit vectors.
        areas: (D,) float32 solid angles of the directions.

    Returns:
        (M, K) float32 in 0..1; exactly 1 where all is open, and where no direction is within the lobe.

    Raises:
        UserError: A tensor has another shape, dtype or device.
    """
    _check(bits, axes, directions, name="axes")
    count = len(directions)
    check_tensors(("edges", edges, ("K",)), ("areas", areas, (count,)), device=bits.device)
    result = areas.new_empty(len(bits), len(edges))
    inputs = (
        bits.contiguous(),
        axes.contiguous(),
        edges,
        directions.contiguous(),
        areas.contiguous(),
        result,
    )
    if bits.is_cuda:
        launch_range(_open_shares, len(bits), *inputs, grain=GRAIN)
    else:
        arriving_cpu.sum_lobes(*inputs)
    return result


def _check(bits: Tensor, vectors: Tensor, directions: Tensor, *, name: str = "normals") -> None:
    check_tensors(
        ("bits", bits, ("M", "W"), torch.int32),
        (name, vectors, ("M", 3)),
        ("directions", directions, (32 * bits.shape[-1], 3)),
        device=bits.device,
    )


class _Arriving(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, bits: Tensor, normals: Tensor, directions: Tensor, powers: Tensor
    ) -> tuple[Tensor, Tensor]:
        given = [tensor.contiguous() for tensor in (bits, normals, directions)]
        arriving, unblocked = torch.empty_like(given[1]), torch.empty_like(given[1])
        inputs = (*given, powers.contiguous(), arriving, unblocked)
        if bits.is_cuda:
            launch_range(_arriving, len(bits), *inputs, grain=GRAIN)
        else:
            arriving_cpu.sum_arriving(*inputs)
        ctx.save_for_backward(*given)
        return arriving, unblocked

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        bits, normals, directions = ctx.saved_tensors
        inputs = (bits, normals, directions, *(grad.contiguous() for grad in upstream))
        if not bits.is_cuda:
            return None, None, None, arriving_cpu.sum_adjoint(*inputs)
        result = torch.empty_like(directions)
        launch_range(_arriving_adjoint, len(directions), *inputs, result, grain=DIRECTION_GRAIN)
        return None, None, None, result


@wp.func
def is_open(bits: wp.array2d[wp.int32], m: wp.int32, direction: wp.int32) -> wp.bool:
    """Whether a direction is open at point m."""
    return ((bits[m, direction // WORD] >> (direction % WORD)) & 1) == 1


@wp.kernel(enable_backward=False)
def _arriving(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array[wp.vec3],
    powers: wp.array[wp.vec3],
    arriving: wp.array[wp.vec3],
    unblocked: wp.array[wp.vec3],
) -> None:
    """One point. Both sums take the same steps, so that they end in the same bits where all is open."""
    m = first + wp.tid()
    n = normals[m]
    open = wp.vec3()
    all = wp.vec3()
    for word in range(bits.shape[1]):
        flags = bits[m, word]
        for k in range(WORD):
            d = WORD * word + k
            cosine = wp.max(wp.dot(n, directions[d]), 0.0)
            light = cosine * powers[d]
            all += light
            open += wp.float32((flags >> k) & 1) * light
    arriving[m] = open
    unblocked[m] = all


@wp.kernel(enable_backward=False)
def _arriving_adjoint(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array[wp.vec3],
    grad_arriving: wp.array[wp.vec3],
    grad_unblocked: wp.array[wp.vec3],
    grad_powers: wp.array[wp.vec3],
) -> None:
    """One direction: the points that it lights, in their order."""
    d = first + wp.tid()
    direction = directions[d]
    total = wp.vec3()
    for m in range(normals.shape[0]):
        cosine = wp.max(wp.dot(normals[m], direction), 0.0)
        total += cosine * (wp.where(is_open(bits, m, d), 1.0, 0.0) * grad_arriving[m] + grad_unblocked[m])
    grad_powers[d] = total


@wp.kernel(enable_backward=False)
def _open_shares(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    axes: wp.array[wp.vec3],
    edges: wp.array[wp.float32],
    directions: wp.array[wp.vec3],
    areas: wp.array[wp.float32],
    result: wp.array2d[wp.float32],
) -> None:
    """The lobes of one point."""
    m = first + wp.tid()
    for k in range(edges.shape[0]):
        open = wp.float32(0.0)
        all = wp.float32(0.0)
        for d in range(directions.shape[0]):
            above = wp.max(wp.dot(axes[m], directions[d]) - edges[k], 0.0)
            weight = above * above * areas[d]
            all += weight
            open += wp.where(is_open(bits, m, d), weight, 0.0)
        result[m, k] = wp.where(all > 0.0, open / all, 1.0)
