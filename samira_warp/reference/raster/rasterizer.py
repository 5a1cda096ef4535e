"""The rasteriser of `samira_warp.kernels.raster.rasterizer` in plain torch: its specification."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.reference.raster.blending import blend
from samira_warp.reference.raster.projection import project


class Rasterized(NamedTuple):
    """An image as the kernels' own, without what they keep to blend again."""

    features: Tensor
    alpha: Tensor
    means2d: Tensor
    visible: Tensor


def rasterize(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, features: Tensor, camera: Camera
) -> Rasterized:
    """As `samira_warp.kernels.raster.rasterizer.rasterize`, in the dtype of ``means``; finite inputs only.

    Every pixel meets every Gaussian: O(N H W) memory.
    """
    projection = project(means, quaternions, scales, opacities, camera)
    order = torch.argsort(projection.depths, stable=True)
    order = order[projection.visible[order]]
    blended = blend(
        projection.means2d,
        projection.conics,
        projection.opacities,
        features,
        order,
        width=camera.width,
        height=camera.height,
    )
    return Rasterized(blended.features, 1.0 - blended.transmittance, projection.means2d, projection.visible)
