"""The rasteriser: Gaussians and per-Gaussian features in, an image of blended features out."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.blending import blend_unchecked
from samira_warp.kernels.raster.projection import project_unchecked
from samira_warp.kernels.raster.tiles import TileBins, bin_tiles_unchecked
from samira_warp.support.image_size import check_size
from samira_warp.support.validation import check_tensors


class ScreenSplats(NamedTuple):
    """Gaussians as they cover an image: constants, to blend other features with.

    Attributes:
        means2d: (N, 2) float32, pixels.
        conics: (N, 3) float32, pixels^-2.
        opacities: (N,) float32 in 0..1, as the low-pass left them.
        bins: The tiles that they touch.
        width: W, pixels.
        height: H, pixels.
    """

    means2d: Tensor
    conics: Tensor
    opacities: Tensor
    bins: TileBins
    width: int
    height: int


class Rasterized(NamedTuple):
    """An image of H x W pixels with C channels, and where its N Gaussians went.

    Attributes:
        features: (H, W, C) float32 blended sums: premultiplied by alpha, no background.
        alpha: (H, W) float32 in 0..1, one minus the transmittance.
        means2d: (N, 2) float32, pixels; part of the graph, so that ``retain_grad`` gives density control its
            screen-space gradients.
        visible: (N,) bool, whether the Gaussian touches the image.
        splats: What `blend_again` takes.
    """

    features: Tensor
    alpha: Tensor
    means2d: Tensor
    visible: Tensor
    splats: ScreenSplats


def rasterize(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, features: Tensor, camera: Camera
) -> Rasterized:
    """Rasterise 3D Gaussians by EWA splatting; differentiable in the first five arguments.

    It is `project`, `bin_tiles` and `blend` in a row, whose inputs are looked at once. The number of
    intersections is read back from the device once; where that must not be, as in a captured graph, call the
    three, with a ``capacity``.

    Args:
        means: (N, 3) float32, world space, metres.
        quaternions: (N, 4) float32 (w, x, y, z), normalised inside.
        scales: (N, 3) float32 standard deviations along the local axes, metres.
        opacities: (N,) float32 in 0..1.
        features: (N, C) float32, finite; any channels, linear, C at least 1.
        camera: The view and the size of the image.

    Raises:
        UserError: If a shape, dtype or device is wrong, or the image larger than `LARGEST_SIDE`.
    """
    check_tensors(
        ("means", means, ("N", 3)),
        ("quaternions", quaternions, ("N", 4)),
        ("scales", scales, ("N", 3)),
        ("opacities", opacities, ("N",)),
        ("features", features, ("N", "C")),
        ("camera.world_to_camera", camera.world_to_camera, (4, 4)),
    )
    width, height = camera.width, camera.height
    check_size("camera", width=width, height=height)
    projection = project_unchecked(means, quaternions, scales, opacities, camera)
    bins = bin_tiles_unchecked(projection, width=width, height=height)
    seen = (projection.means2d, projection.conics, projection.opacities)
    image = blend_unchecked(*seen, features, bins, width=width, height=height)
    means2d, conics, opacities = (values.detach() for values in seen)
    splats = ScreenSplats(means2d, conics, opacities, bins, width, height)
    return Rasterized(
        image.features, 1.0 - image.transmittance, projection.means2d, projection.visible, splats
    )


def blend_again(splats: ScreenSplats, features: Tensor) -> Tensor:
    """Blend further features of Gaussians that were rasterised; differentiable in the features alone.

    Args:
        splats: From `rasterize`.
        features: (N, C) float32, finite, on the same device.

    Returns:
        (H, W, C) float32 blended sums, as `Rasterized.features`.

    Raises:
        UserError: The features have another shape, dtype or device.
    """
    check_tensors(("features", features, (len(splats.means2d), "C")), device=splats.means2d.device)
    means2d, conics, opacities, bins, width, height = splats
    image = blend_unchecked(means2d, conics, opacities, features, bins, width=width, height=height)
    return image.features
