"""How bright and of which colour skin is: what tells albedo from light where nothing else does.

Pictures show the product of the two. In the ranges of measured skin every albedo is as good as any other;
outside, a head and its light are brighter and darker than people are.

The ranges enclose, in CIELAB under D65:

- L* from 24 to 76: from below the darkest of five clusters of facial skin, at (26.7, 14.6, 14.7), of 120
  people (Proposed shade guide for human facial skin, IADR 2009), to three standard deviations above the
  lightest cheeks, 59.6 +- 5.5 of 187 people (Xiao et al., Characterising the variations in ethnic skin
  colours, Skin Research and Technology 23, 2017);
- a* from 5.6, two standard deviations below the palest of those cheeks, 11.8 +- 3.1, to 25.5, the reddest
  cluster of the first; b* from 9.4, the same of 14.6 +- 2.6, to 21, the yellowest of De Rigal et al. (Skin
  Research and Technology 16, 2010).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import Gaussians
from samira_warp.head.regions import REGIONS, response_coverage, route_faces
from samira_warp.head.template import HeadTemplate
from samira_warp.light.color import LUMINANCE

SKIN_REGIONS = ("forehead", "nose", "cheeks")
"""Regions of bare skin, beards aside, which the ranges have room for."""

_LEAST = 1e-4
"""Of albedo in a logarithm."""


class Range(NamedTuple):
    """From the lowest to the highest of what was measured."""

    low: float
    high: float


SKIN_LUMINANCE = Range(0.041, 0.50)
"""Of linear albedo: L* from 24 to 76."""

SKIN_GREEN = Range(0.29, 0.77)
"""Green over red of linear albedo: from that of (41.5, 25.5, 13.3) to that of (76, 5.6, 9.4)."""

SKIN_BLUE = Range(0.53, 0.93)
"""Blue over green of linear albedo: from that of (44, 14, 21) to that of (41.5, 25.5, 13.3)."""


def skin_faces(template: HeadTemplate) -> np.ndarray:
    """(F,) bool: faces of bare skin, as far as the template's masks say which are."""
    skin = [REGIONS.index(name) for name in SKIN_REGIONS]
    return np.isin(route_faces(template), skin) & response_coverage(template)


def luminance(albedo: Tensor) -> Tensor:
    """(...) luminance of (..., 3) linear values."""
    return albedo @ albedo.new_tensor(LUMINANCE)


def mean_skin(gaussians: Gaussians, skin: Tensor) -> Tensor:
    """(3,) mean linear albedo of the Gaussians on skin, by the area that they cover.

    Args:
        gaussians: The avatar's.
        skin: (F,) bool, faces of skin.
    """
    with torch.no_grad():
        # hidden and faint ones would take a penalty on themselves that no picture contradicts
        scales = gaussians.scales.sort(dim=1).values
        weights = gaussians.opacities * scales[:, 1] * scales[:, 2] * skin[gaussians.faces.long()]
        weights /= weights.sum().clamp(min=1e-12)
    return weights @ gaussians.albedo


def skin_prior(albedo: Tensor) -> Tensor:
    """Squared distance of skin's albedo from what was measured, in natural logarithms; 0 within.

    It is meant for the mean over a face: a mole may be dark.

    Args:
        albedo: (3,) linear.
    """
    red, green, blue = albedo.clamp(min=_LEAST)
    values = torch.stack([luminance(albedo).clamp(min=_LEAST), green / red, blue / green])
    ranges = values.new_tensor([SKIN_LUMINANCE, SKIN_GREEN, SKIN_BLUE]).log()
    logarithms = values.log()
    return (logarithms - logarithms.clamp(ranges[:, 0], ranges[:, 1])).square().sum()
