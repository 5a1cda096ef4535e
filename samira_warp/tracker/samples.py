"""Where on a head it is compared with the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from samira_warp.geometry.mesh import face_areas
from samira_warp.head.regions import REGIONS, route_faces
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.surface_points import SurfacePoints

SAMPLES = 2400
"""Points; twice as many move no frame by a twentieth of a pixel."""

DENSITY = {
    "lips": 4.0,
    "left_eye": 4.0,
    "right_eye": 4.0,
    "nose": 2.0,
    "cheeks": 1.0,
    "forehead": 1.0,
    "ears": 0.7,
    "neck": 0.15,
    "scalp": 0.15,
    "mouth": 0.0,
}
"""Points for an area where colours are compared, by region. Hair is no part of the head, and necks do not go
with it; what is inside the mouth is seen too seldom to be known."""


@dataclass(frozen=True, eq=False)
class Samples:
    """S points of the surface.

    Attributes:
        points: How they move.
        corners: (S, 3) int64 vertex ids.
        barycentrics: (S, 3) float32.
    """

    points: SurfacePoints
    corners: Tensor
    barycentrics: Tensor

    @classmethod
    def build(
        cls, head: TrackedHead, *, count: int = SAMPLES, density: Mapping[str, float] = DENSITY, seed: int = 0
    ) -> Samples:
        """Scatter points over a head, so many for an area of each region."""
        generator = torch.Generator().manual_seed(seed)
        by_region = torch.tensor([density[region] for region in REGIONS])
        regions = torch.from_numpy(route_faces(head.template))
        wanted = (face_areas(head.rig.v_template, head.faces) * by_region[regions]).double()
        cumulative = wanted.cumsum(dim=0)
        marks = (torch.arange(count) + torch.rand(1, generator=generator)).double() / count * cumulative[-1]
        chosen = torch.searchsorted(cumulative, marks).clamp(max=len(wanted) - 1)
        pair = torch.rand(count, 2, generator=generator)
        pair = torch.where(pair.sum(dim=1, keepdim=True) > 1.0, 1.0 - pair, pair)
        barycentrics = torch.cat([pair, 1.0 - pair.sum(dim=1, keepdim=True)], dim=1)
        corners = head.faces[chosen]
        return cls(head.surface_points(corners, barycentrics), corners, barycentrics)

    @classmethod
    def at_vertices(cls, head: TrackedHead) -> Samples:
        """The vertices themselves, each as a corner of one of its faces."""
        count = len(head.rig.v_template)
        face, corner = torch.zeros(count, dtype=torch.long), torch.zeros(count, dtype=torch.long)
        for place in range(3):
            face[head.faces[:, place]] = torch.arange(len(head.faces))
            corner[head.faces[:, place]] = place
        corners, barycentrics = head.faces[face], torch.eye(3)[corner]
        return cls(head.surface_points(corners, barycentrics), corners, barycentrics)

    def of(self, values: Tensor) -> Tensor:
        """(..., S, C) of (..., V, C) values of the vertices."""
        return (values[..., self.corners, :] * self.barycentrics[..., None]).sum(dim=-2)
