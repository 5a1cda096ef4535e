"""What keeps a Gaussian the size of its triangle, and near it.

Pictures say little of how deep a Gaussian is or how far it reaches along the line of sight; unheld, one in a
hundred grows to centimetres, and from the side it is a spike or floats behind the head. GaussianAvatars hold
size and distance by two terms of the objective from a threshold on. A limit needs no weight, and holds.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from samira_warp.avatar import Gaussians

REACH = 1.0
"""Distance of a centre from its triangle's own, in units of the triangle's scale (GaussianAvatars'
threshold)."""

AXIS_LIMIT = 0.8
"""Longest standard deviation in units of the triangle's scale: with neighbours half as far apart there is no
hole between them. GaussianAvatars' term begins at 0.6."""

AXIS_LONGEST = 6e-3
"""Metres: the same where triangles are large, at the back of a head."""

AXIS_RATIO = 15.0
"""Longest over shortest axis: a disc of a triangle's size is then as thin as skin shows it, half a
millimetre."""


def longest_axes(face_scales: Tensor, spread: Tensor) -> Tensor:
    """(F,) metres that a Gaussian's axes may reach on each face.

    Args:
        face_scales: (F,) k of every face at rest, metres.
        spread: (F,) metres, what Gaussians start with: where they are fewer than triangles, each has to reach
            beyond its own.
    """
    return torch.maximum((AXIS_LIMIT * face_scales).clamp(max=AXIS_LONGEST), spread)


@torch.no_grad()
def hold_shapes(gaussians: Gaussians, face_scales: Tensor, longest: Tensor) -> None:
    """Bring every Gaussian within the limits.

    Args:
        gaussians: Changed in place.
        face_scales: (F,) k of every face at rest, metres.
        longest: (F,) metres, `longest_axes`.
    """
    means, log_scales = gaussians.means, gaussians.log_scales
    means.mul_(REACH / means.norm(dim=1, keepdim=True).clamp(min=REACH))
    ceiling = (longest / face_scales)[gaussians.faces.long()].log()
    log_scales.copy_(torch.minimum(log_scales, ceiling[:, None]))
    shortest = log_scales.amax(dim=1, keepdim=True) - math.log(AXIS_RATIO)
    log_scales.copy_(torch.maximum(log_scales, shortest))
