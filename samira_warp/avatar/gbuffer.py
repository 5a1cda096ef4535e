"""The G-buffer: what the rasteriser blends, by name, and what deferred shading reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.rasterizer import ScreenSplats, blend_again, rasterize
from samira_warp.kernels.raster.straight import straighten
from samira_warp.kernels.shading.checks import check_surface
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.validation import check_tensor
from samira_warp.surface import CHANNELS, LIGHT_CHANNELS, LIGHT_WIDTH, SURFACE_CHANNELS, Surface


class ScreenGaussians(NamedTuple):
    """What density control looks at after a backward pass.

    Attributes:
        means2d: (N, 2) pixels; its gradient is retained where gradients are on.
        visible: (N,) bool.
    """

    means2d: Tensor
    visible: Tensor


@dataclass(frozen=True, eq=False)
class GBuffer(Surface):
    """The straight (not premultiplied) surface of every pixel, its channels (H, W, width), and where it is.

    Attributes:
        depth: (H, W, 1) metres along the camera's axis.
        alpha: (H, W, 1) coverage, 0..1.
        screen: The Gaussians in the image plane.
        splats: The same as constants, to blend more of them.
    """

    depth: Tensor
    alpha: Tensor
    screen: ScreenGaussians
    splats: ScreenSplats


def render_gbuffer(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    surface: Surface,
    camera: Camera,
    *,
    lit: bool = False,
) -> GBuffer:
    """Blend world-space Gaussians into a G-buffer.

    Args:
        means: (N, 3) metres, world space.
        quaternions: (N, 4) w, x, y, z.
        scales: (N, 3) metres.
        opacities: (N,).
        surface: Channels (N, width) of the Gaussians.
        camera: The view.
        lit: Blend the channels of light as well; False leaves them neutral, for `blend_arrival`.

    Returns:
        The blended sums divided by max(alpha, 1/255), directions renormalised; channels of light are 1 where
        next to nothing covers a pixel.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_surface(surface, count=means.shape[0], device=means.device)
    depths = (means - camera.center) @ camera.world_to_camera[2, :3]
    names = [*SURFACE_CHANNELS, *(LIGHT_CHANNELS if lit else ())]
    features = torch.cat([*(getattr(surface, name) for name in names), depths[:, None]], dim=1)
    blended = rasterize(means, quaternions, scales, opacities, features, camera)
    if blended.means2d.requires_grad:
        blended.means2d.retain_grad()
    straight = straighten(blended.features, blended.alpha)
    screen = ScreenGaussians(blended.means2d, blended.visible)
    return GBuffer(
        **straight.surface.channels(),
        depth=straight.depth,
        alpha=blended.alpha[..., None],
        screen=screen,
        splats=blended.splats,
    )


def blend_arrival(gbuffer: GBuffer, arrival: Tensor) -> GBuffer:
    """Blend what of a light arrives at the Gaussians into a G-buffer that was made without it.

    It is differentiable in ``arrival`` alone. Training has to blend it with the rest (`render_gbuffer`): a
    Gaussian from the dark inside of the mouth that stands before the skin is seen by its darkness alone.

    Args:
        gbuffer: As the Gaussians were rasterised.
        arrival: (N, C) float32, the channels of light side by side, in the table's order.

    Returns:
        The G-buffer with those channels; neutral where next to nothing covers a pixel.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_tensor("arrival", arrival, shape=("N", LIGHT_WIDTH), device=gbuffer.alpha.device)
    alpha = gbuffer.alpha.detach()
    straight = blend_again(gbuffer.splats, arrival) / alpha.clamp(min=COVERED_ALPHA)
    arrived: dict[str, Any] = {**light_channels(torch.where(alpha >= COVERED_ALPHA, straight, 1.0))}
    return replace(gbuffer, **arrived)


def light_channels(arrival: Tensor) -> dict[str, Tensor]:
    """The channels of light by name of (..., C), where they lie side by side in the table's order."""
    widths = [CHANNELS[name].width for name in LIGHT_CHANNELS]
    return dict(zip(LIGHT_CHANNELS, arrival.split(widths, dim=-1), strict=True))
