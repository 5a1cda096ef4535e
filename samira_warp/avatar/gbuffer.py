"""The G-buffer: what the rasteriser blends, by name, and what deferred shading reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.support.constants import COVERED_ALPHA


class SurfaceAttributes(NamedTuple):
    """What each Gaussian contributes to the G-buffer besides its depth; the order is the order of the blended
    channels.

    Attributes:
        albedo: (N, 3) linear.
        normal: (N, 3) unit, world space.
        roughness: (N, 1).
        specular: (N, 1) reflectance f.
        response_diffuse: (N, 1) tau^d.
        response_specular: (N, 1) tau^s.
    """

    albedo: torch.Tensor
    normal: torch.Tensor
    roughness: torch.Tensor
    specular: torch.Tensor
    response_diffuse: torch.Tensor
    response_specular: torch.Tensor


class ScreenGaussians(NamedTuple):
    """What density control looks at after a backward pass.

    Attributes:
        means2d: (N, 2) pixels; its gradient is retained where gradients are on.
        visible: (N,) bool.
    """

    means2d: torch.Tensor
    visible: torch.Tensor


@dataclass(frozen=True, eq=False)
class GBuffer:
    """Straight (not premultiplied) surface attributes of every pixel.

    Attributes:
        albedo: (H, W, 3) linear.
        normal: (H, W, 3) unit, world space; zero where nothing is.
        roughness: (H, W, 1).
        specular: (H, W, 1).
        response_diffuse: (H, W, 1).
        response_specular: (H, W, 1).
        depth: (H, W, 1) metres along the camera's axis.
        alpha: (H, W, 1) coverage, 0..1.
        screen: The Gaussians in the image plane.
    """

    albedo: torch.Tensor
    normal: torch.Tensor
    roughness: torch.Tensor
    specular: torch.Tensor
    response_diffuse: torch.Tensor
    response_specular: torch.Tensor
    depth: torch.Tensor
    alpha: torch.Tensor
    screen: ScreenGaussians


def render_gbuffer(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    attributes: SurfaceAttributes,
    camera: Camera,
) -> GBuffer:
    """Blend world-space Gaussians into a G-buffer.

    Args:
        means: (N, 3) metres, world space.
        quaternions: (N, 4) w, x, y, z.
        scales: (N, 3) metres.
        opacities: (N,).
        attributes: The blended channels.
        camera: The view.

    Returns:
        The blended sums divided by max(alpha, 1/255), the normal renormalised.
    """
    depths = (means - camera.center) @ camera.world_to_camera[2, :3]
    features = torch.cat([*attributes, depths[:, None]], dim=1)
    blended = rasterize(means, quaternions, scales, opacities, features, camera)
    if blended.means2d.requires_grad:
        blended.means2d.retain_grad()
    alpha = blended.alpha[..., None]
    straight = blended.features / alpha.clamp(min=COVERED_ALPHA)
    widths = [attribute.shape[1] for attribute in attributes]
    channels = dict(
        zip((*SurfaceAttributes._fields, "depth"), straight.split([*widths, 1], dim=-1), strict=True)
    )
    channels["normal"] = torch.nn.functional.normalize(channels["normal"], dim=-1)
    return GBuffer(**channels, alpha=alpha, screen=ScreenGaussians(blended.means2d, blended.visible))
