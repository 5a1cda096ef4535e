"""Straight surfaces of `samira_warp.kernels.raster.straight` in plain torch: their specification."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.raster.straight import Straight
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.surface import CHANNELS, LIGHT_CHANNELS, SURFACE_CHANNELS, SURFACE_WIDTH, Surface


def straighten(sums: Tensor, alpha: Tensor) -> Straight:
    """See `kernels.raster.straight.straighten`; of any dtype."""
    alpha = alpha[..., None]
    means = sums / alpha.clamp(min=COVERED_ALPHA)
    lit = sums.shape[-1] > SURFACE_WIDTH + 1
    names = [*SURFACE_CHANNELS, *(LIGHT_CHANNELS if lit else ())]
    *parts, depth = means.split([*(CHANNELS[name].width for name in names), 1], dim=-1)
    channels = dict(zip(names, parts, strict=True))
    if lit:
        channels |= {
            name: torch.where(alpha >= COVERED_ALPHA, channels[name], 1.0) for name in LIGHT_CHANNELS
        }
    surface = Surface.of(**channels)
    return Straight(
        surface.map(lambda mean: torch.nn.functional.normalize(mean, dim=-1), blend="direction"), depth
    )
