"""The filters of `samira_warp.kernels.cubemap.filter` in plain torch: sums over all pairs of texels."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles


def irradiance(radiance: Tensor, *, size: int = 16) -> Tensor:
    """As `samira_warp.kernels.cubemap.filter.irradiance`; any floating dtype."""
    weights = _cosines(radiance, size).clamp(min=0) * _areas(radiance)
    return _apply(weights / torch.pi, radiance, size)


def prefilter(base: Tensor, *, ladder: Sequence[tuple[float, int]]) -> tuple[Tensor, ...]:
    """As `samira_warp.kernels.cubemap.filter.prefilter`; any floating dtype."""
    mips = [base]
    for roughness, size in ladder:
        weights = lobe_weights(base, roughness, size)
        mips.append(_apply(weights / weights.sum(dim=1, keepdim=True), base, size))
    return tuple(mips)


def lobe_weights(base: Tensor, roughness: float, size: int) -> Tensor:
    """(6 size^2, B) weights D_GGX(n . h) max(n . l, 0) dOmega of the base's texels, not normalised.

    Their sums approach the integral over the sphere: with h half-way between n and l, dOmega_l = 4 (n . h)
    dOmega_h.
    """
    cosines = _cosines(base, size)
    alpha = roughness * roughness
    normal_half_squared = (1 + cosines) / 2
    distribution = alpha**2 / (torch.pi * (normal_half_squared * (alpha**2 - 1) + 1) ** 2)
    return distribution * cosines.clamp(min=0) * _areas(base)


def _cosines(base: Tensor, size: int) -> Tensor:
    """(6 size^2, B) n . l of all texels of the result with all of ``base``."""
    normals, lights = (
        texel_directions(edge, dtype=base.dtype, device=base.device).view(-1, 3)
        for edge in (size, base.shape[1])
    )
    return normals @ lights.T


def _areas(base: Tensor) -> Tensor:
    size = base.shape[1]
    return texel_solid_angles(size, dtype=base.dtype, device=base.device).expand(6, size, size).reshape(-1)


def _apply(weights: Tensor, base: Tensor, size: int) -> Tensor:
    return (weights @ base.reshape(-1, base.shape[-1])).view(6, size, size, -1)
