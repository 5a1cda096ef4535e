"""A plain paint for heads that have none: skin, lips, brows, hair, eyes and teeth by a template's masks.

It is enough for a landmark network to know a face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from samira_warp.head.atlas import UvAtlas
from samira_warp.head.template import HeadTemplate

SKIN = (0.50, 0.33, 0.25)

COLOURS = {
    "scalp": (0.05, 0.035, 0.025),
    "lips": (0.36, 0.14, 0.12),
    "mouth": (0.05, 0.01, 0.01),
    "teeth": (0.55, 0.52, 0.45),
    "teeth_upper": (0.55, 0.52, 0.45),
    "teeth_lower": (0.55, 0.52, 0.45),
}
"""Linear albedo by mask, the later over the earlier."""

WHITE, IRIS, PUPIL = (0.60, 0.58, 0.55), (0.10, 0.14, 0.16), (0.01, 0.01, 0.01)
"""Of the eyes."""

IRIS_SIZE, PUPIL_SIZE = 5.9, 2.2
"""Radii, millimetres, in front view."""

BROW = ((-19.0, 17.5, 3.4), (-6.0, 22.0, 3.2), (8.0, 24.0, 2.4), (22.0, 20.0, 1.0))
"""Outwards from the eyeball's middle, above it, and half as wide, millimetres."""

BROW_COLOUR = (0.06, 0.04, 0.03)

FINISH = (0.55, 0.028, 0.3)
"""Roughness, reflectance at normal incidence, and how much light scatters below, everywhere."""


@dataclass(frozen=True, eq=False)
class PlainMaterials:
    """What a head's surface is made of, in its UV layout: `samira_subject.studio.MaterialsLike`.

    Attributes:
        albedo: (S, S, 3) float32 linear diffuse reflectance.
        finish: (S, S, 3) float32.
    """

    albedo: Tensor
    finish: Tensor

    def relief(self, expression: Tensor, jaw: float) -> Tensor:
        """(S, S, 3) zeros: it has no bumps."""
        return torch.zeros_like(self.albedo)


def plain_paint(template: HeadTemplate, *, size: int) -> PlainMaterials:
    """Paint a head whose UV coordinates are one atlas.

    Args:
        template: The head.
        size: S, width and height of the maps.
    """
    atlas = UvAtlas.build(template, size=size)
    place = 1000.0 * atlas.positions(torch.from_numpy(template.v_template)).double().numpy()
    albedo = np.broadcast_to(SKIN, place.shape).copy()
    for name, colour in COLOURS.items():
        _mix(albedo, colour, _share(atlas, template, name))
    for side, name in ((1.0, "left_eyeball"), (-1.0, "right_eyeball")):
        members = template.masks.get(name, np.zeros(0, np.int32))
        if len(members):
            ball = 1000.0 * template.v_template[members]
            away = place - 0.5 * (ball.min(axis=0) + ball.max(axis=0))
            _mix(albedo, BROW_COLOUR, _brow(away, side) * (1.0 - _share(atlas, template, "scalp")))
            of_ball = _share(atlas, template, name)
            _mix(albedo, WHITE, of_ball)
            ahead = of_ball * (away[..., 2] > 0.0)
            radius = np.hypot(away[..., 0], away[..., 1])
            _mix(albedo, IRIS, ahead * _edge(radius, IRIS_SIZE))
            _mix(albedo, PUPIL, ahead * _edge(radius, PUPIL_SIZE))
    finish = torch.tensor(FINISH).expand(size, size, 3).contiguous()
    return PlainMaterials(torch.from_numpy(albedo.astype(np.float32)), finish)


def _share(atlas: UvAtlas, template: HeadTemplate, name: str) -> np.ndarray:
    """(S, S) how much of a texel's face belongs to a mask."""
    members = torch.zeros(len(template.v_template), 1)
    members[template.masks.get(name, [])] = 1.0
    values = torch.cat([members, members, members], dim=1)
    return atlas.positions(values)[..., 0].double().numpy()


def _mix(albedo: np.ndarray, colour: tuple[float, float, float], share: np.ndarray) -> None:
    """Lay a colour over what is there, in place."""
    albedo += share[..., None] * (np.array(colour) - albedo)


def _edge(distance: np.ndarray, radius: float) -> np.ndarray:
    """1 within a radius and 0 beyond, over half a millimetre."""
    return np.clip((radius - distance) / 0.5 + 0.5, 0.0, 1.0)


def _brow(away: np.ndarray, side: float) -> np.ndarray:
    """(S, S) share of a brow, at (S, S, 3) millimetres from its eyeball's middle."""
    outwards, above, half = np.array(BROW).T
    x = side * away[..., 0]
    inside = (x > outwards[0]) & (x < outwards[-1]) & (away[..., 2] > 0.0)
    off = np.abs(away[..., 1] - np.interp(x, outwards, above))
    return inside * np.clip((np.interp(x, outwards, half) - off) / 0.8 + 0.5, 0.0, 1.0)
