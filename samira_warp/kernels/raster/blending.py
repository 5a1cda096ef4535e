"""Alpha blending of projected Gaussians, front to back, and the adjoint.

With sigma = (1/2) d' K d at the offset d of a pixel centre from the mean, a pixel sees Gaussian k with

    alpha_k = min(ALPHA_MAX, o_k exp(-sigma_k)),   weight_k = alpha_k T_k,
    T_{k+1} = T_k (1 - alpha_k),   T_1 = 1

where alpha below ALPHA_MIN counts as 0 and the pixel stops before T would fall below TRANSMITTANCE_MIN. The
result is sum_k weight_k f_k and the last T. The adjoint goes front to back too, with the sum still to come as
running state:

    dL/df_k = sum over pixels of weight_k g,
    dL/dalpha_k = T_k (f_k . g) - (sum_{j > k} weight_j (f_j . g) + T g_T) / (1 - alpha_k)

for the gradients g and g_T of the two results.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.raster import blending_cpu, blending_cuda
from samira_warp.kernels.raster.slots import sum_slots
from samira_warp.kernels.raster.splats import pack_splats
from samira_warp.kernels.raster.tiles import TileBins, tile_grid
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors

CHANNELS_AT_ONCE = 64
"""More channels are blended group by group: the CPU keeps a tile's sums of all channels of a group on its
stack, 2 KB each."""


class Blended(NamedTuple):
    """What an image of H x W pixels shows of N Gaussians with C channels.

    Attributes:
        features: (H, W, C) float32, sum of weight times feature: not divided by alpha, no background.
        transmittance: (H, W) float32 in 0..1, the share of what lies behind that still shows.
    """

    features: Tensor
    transmittance: Tensor


def blend(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    bins: TileBins,
    *,
    width: int,
    height: int,
) -> Blended:
    """Blend Gaussians into pixels; differentiable in the first four arguments through both results.

    Bitwise the same on every run and for any number of threads, gradients included.

    Args:
        means2d: (N, 2) float32, pixels.
        conics: (N, 3) float32, (xx, xy, yy) of the inverse covariance, pixels^-2.
        opacities: (N,) float32 in 0..1.
        features: (N, C) float32, finite, C at least 1.
        bins: From `bin_tiles` on the same Gaussians and image size.
        width: W, pixels.
        height: H, pixels.

    Raises:
        UserError: If a shape, dtype or device is wrong, or the bins are another image's.
    """
    _check(means2d, conics, opacities, features, bins, width, height)
    return blend_unchecked(means2d, conics, opacities, features, bins, width=width, height=height)


def blend_unchecked(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    bins: TileBins,
    *,
    width: int,
    height: int,
) -> Blended:
    """`blend`, of tensors that were looked at."""
    geometry = [tensor.contiguous() for tensor in (means2d, conics, opacities)]
    groups = features.split(CHANNELS_AT_ONCE, dim=1)
    blended = [Blended(*_Blend.apply(*geometry, group.contiguous(), bins, width, height)) for group in groups]
    if len(blended) == 1:
        return blended[0]
    return Blended(torch.cat([group.features for group in blended], dim=2), blended[0].transmittance)


def _check(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    bins: TileBins,
    width: int,
    height: int,
) -> None:
    check_tensors(
        ("means2d", means2d, ("N", 2)),
        ("conics", conics, ("N", 3)),
        ("opacities", opacities, ("N",)),
        ("features", features, ("N", "C")),
    )
    count, tiles = len(means2d), bins.columns * bins.rows
    check_tensors(
        ("bins.tile_offsets", bins.tile_offsets, (tiles + 1,), torch.int32),
        ("bins.records", bins.records, ("I",), torch.int32),
        ("bins.slots", bins.slots, ("I",), torch.int32),
        ("bins.order", bins.order, (count,), torch.int32),
        ("bins.slot_offsets", bins.slot_offsets, (count + 1,), torch.int32),
        ("bins.record_offsets", bins.record_offsets, (count + 1,), torch.int32),
        device=means2d.device,
    )
    if (bins.columns, bins.rows) != tile_grid(width, height):
        raise UserError(
            "bins",
            expected=f"tiles of an image of {width} x {height} pixels",
            found=f"{bins.columns} x {bins.rows} tiles",
        )


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means2d: Tensor,
        conics: Tensor,
        opacities: Tensor,
        features: Tensor,
        bins: TileBins,
        width: int,
        height: int,
    ) -> tuple[Tensor, Tensor]:
        side = blending_cuda if means2d.is_cuda else blending_cpu
        splats = pack_splats(means2d, conics, opacities, features, bins, multiple=side.LANES)
        blended = side.forward(splats, bins, features.shape[1], width, height)
        *lists, columns, rows = bins
        ctx.save_for_backward(splats, *blended, *lists)
        ctx.grid = columns, rows
        return blended

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_features: Tensor, grad_transmittance: Tensor) -> tuple[Tensor | None, ...]:
        splats, features, transmittance, *lists = ctx.saved_tensors
        bins = TileBins(*lists, *ctx.grid)
        side = blending_cuda if splats.is_cuda else blending_cpu
        grad_slots = side.adjoint(
            splats, bins, features, transmittance, grad_features.contiguous(), grad_transmittance.contiguous()
        )
        return *sum_slots(grad_slots, bins, grad_features.shape[2]), None, None, None
