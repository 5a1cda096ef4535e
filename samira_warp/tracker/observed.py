"""What is seen of a head in a film, as the fit takes it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class View:
    """The camera of a film, which stands still at (0, 0, 1) and looks along -z; the head moves.

    Attributes:
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
        cx: Principal point from the left edge, pixels: the middle of what was filmed, not of what was kept.
        cy: Principal point from the upper edge, pixels.
    """

    width: int
    height: int
    cx: float
    cy: float

    def in_camera(self, points: Tensor) -> Tensor:
        """(..., 3) points of the world in the camera's OpenCV axes, metres."""
        return points * points.new_tensor([1.0, -1.0, -1.0]) + points.new_tensor([0.0, 0.0, DISTANCE])

    def project(self, points: Tensor, focal: float | Tensor) -> Tensor:
        """(..., 2) pixels of (..., 3) points in camera axes, by a focal length in pixels."""
        return focal * points[..., :2] / points[..., 2:] + points.new_tensor([self.cx, self.cy])

    def world_to_camera(self) -> Tensor:
        """(4, 4) float32 rigid transform."""
        return torch.tensor(
            [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, DISTANCE], [0.0, 0.0, 0.0, 1.0]]
        )


DISTANCE = 1.0
"""Metres from the camera to the world's origin."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Landmarks of one face in N frames.

    Attributes:
        points: (N, L, 2) float32 pixels.
        depths: (N, L) float32, in pixels as well, smaller nearer; rough.
        seen: (N, L) float32 trust in each, 0 where there is none.
        gaps: (N, G, 2) float32 pixels from the lower to the upper one of each of `faces.GAPS`.
        gaps_seen: (N, G) float32 trust in each.
    """

    points: Tensor
    depths: Tensor
    seen: Tensor
    gaps: Tensor
    gaps_seen: Tensor

    def rows(self, rows: slice | Tensor) -> Landmarks:
        """Those of some frames."""
        return Landmarks(*(getattr(self, field.name)[rows] for field in fields(self)))

    def only(self, ids: Tensor) -> Landmarks:
        """Some of the landmarks, all of the gaps."""
        return replace(self, points=self.points[:, ids], depths=self.depths[:, ids], seen=self.seen[:, ids])
