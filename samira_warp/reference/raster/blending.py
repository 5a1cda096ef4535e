"""The blending of `samira_warp.kernels.raster.blending` in plain torch: its specification."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.raster.blending import Blended
from samira_warp.support.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN


def blend(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    order: Tensor,
    *,
    width: int,
    height: int,
) -> Blended:
    """As `samira_warp.kernels.raster.blending.blend`, without tile bins.

    It takes the Gaussians to blend, front to back, and every pixel meets every one: O(N H W) memory.

    Args:
        means2d: (N, 2) pixels.
        conics: (N, 3) pixels^-2.
        opacities: (N,).
        features: (N, C).
        order: (M,) integer indices of the Gaussians that are seen, by depth.
        width: W, pixels.
        height: H, pixels.
    """
    order = order.long()
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([x.flatten(), y.flatten()], dim=-1).to(means2d) + 0.5
    dx, dy = (pixels[:, None] - means2d[order]).unbind(-1)
    xx, xy, yy = conics[order].unbind(-1)
    sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy

    alpha = torch.clamp(opacities[order] * torch.exp(-sigma), max=ALPHA_MAX)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
    # transmittance never grows: once it would fall below the limit, so it would for all that follow
    blended = torch.cumprod(1.0 - alpha, dim=1) >= TRANSMITTANCE_MIN
    alpha = torch.where(blended, alpha, 0.0)
    behind = torch.cumprod(1.0 - alpha, dim=1)
    before = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], dim=1)
    transmittance = behind[:, -1] if order.numel() else behind.new_ones(height * width)
    image = (alpha * before[:, : alpha.shape[1]]) @ features[order]
    return Blended(image.view(height, width, -1), transmittance.view(height, width))
