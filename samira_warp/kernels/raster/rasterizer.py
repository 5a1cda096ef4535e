"""The rasteriser: Gaussians and per-Gaussian features in, an image of blended features out."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.blending import blend
from samira_warp.kernels.raster.projection import project
from samira_warp.kernels.raster.tiles import bin_tiles


class Rasterized(NamedTuple):
    """An image of H x W pixels with C channels, and where its N Gaussians went.

    Attributes:
        features: (H, W, C) float32 blended sums: premultiplied by alpha, no background.
        alpha: (H, W) float32 in 0..1, one minus the transmittance.
        means2d: (N, 2) float32, pixels; part of the graph, so that ``retain_grad`` gives density control its
            screen-space gradients.
        visible: (N,) bool, whether the Gaussian touches the image.
        depths: (N,) float32, metres along the camera's z axis; 0 where not visible.
    """

    features: Tensor
    alpha: Tensor
    means2d: Tensor
    visible: Tensor
    depths: Tensor


def rasterize(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    camera: Camera,
    *,
    capacity: int | None = None,
) -> Rasterized:
    """Rasterise 3D Gaussians by EWA splatting; differentiable in the first five arguments through features,
    alpha and depths.

    Args:
        means: (N, 3) float32, world space, metres.
        quaternions: (N, 4) float32 (w, x, y, z), normalised inside.
        scales: (N, 3) float32 standard deviations along the local axes, metres.
        opacities: (N,) float32 in 0..1.
        features: (N, C) float32, finite; any channels, linear, C at least 1.
        camera: The view and the size of the image.
        capacity: See `bin_tiles`; None reads the number of intersections back from the device, once.

    Raises:
        UserError: If a shape, dtype or device is wrong.
    """
    projection = project(means, quaternions, scales, opacities, camera)
    size = {"width": camera.width, "height": camera.height}
    bins = bin_tiles(projection, opacities, capacity=capacity, **size)
    blended = blend(projection.means2d, projection.conics, opacities, features, bins, **size)
    return Rasterized(
        blended.features,
        1.0 - blended.transmittance,
        projection.means2d,
        projection.visible,
        projection.depths,
    )
