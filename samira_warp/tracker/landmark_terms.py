"""Landmarks as terms of a fit: where they are seen, and how far lids and lips are apart."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.observed import Landmarks, View
from samira_warp.tracker.surface_points import PosedPoints, SurfacePoints
from samira_warp.tracker.unknowns import Unknowns

CHUNK = 64
"""Frames at once: 80 MB of derivatives."""

SPREAD = 0.0015
"""Metres on the head, one standard deviation of a landmark: two pixels where a head fills 512."""

TAIL = 2.5
"""Standard deviations beyond which a residual is taken for a mistake more and more (Cauchy)."""

ALIKE = 8.0
"""Landmarks err together, as a network does: so many count as one."""

FACING = (-0.2, 0.3)
"""Cosines of normal and view between which trust in a landmark rises from the least to all: on the far side
the network guesses."""

HIDDEN = 0.03
"""Trust in landmarks that face away."""


@dataclass(frozen=True, eq=False)
class LandmarkTerm:
    """Squared distances in the picture between landmarks and their points on the head, Cauchy's way.

    Attributes:
        points: The landmarks' points on the head.
        normals: (L, 3) float32 unit normals there, on the head at rest.
        landmarks: Where they are seen.
        view: The camera.
        trust: (L,) float32 factor on each landmark's weight.
        precision: (N, 1) float32 inverse variance of a landmark in pixels, by how large the face is.
    """

    points: SurfacePoints
    normals: Tensor
    landmarks: Landmarks
    view: View
    trust: Tensor
    precision: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the robust sum."""
        return sum(
            self.cost_of(pose(self.points, unknowns, rows), unknowns, rows)
            for rows in chunks(len(unknowns.frames))
        )

    def cost_of(self, posed: PosedPoints, unknowns: Unknowns, rows: slice) -> float:
        """Some frames' share of `cost`, whose points are posed."""
        _, scaled, trust = self._residuals(unknowns, rows, posed.points)
        squared = scaled.square().sum(dim=-1)
        return 0.5 * float((trust * TAIL**2 * torch.log1p(squared / TAIL**2)).double().sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares, weighted as Cauchy's function grows there."""
        for rows in chunks(len(unknowns.frames)):
            posed = pose(self.points, unknowns, rows)
            moves = in_picture(posed, self.view, unknowns, subject=equations.with_subject)
            self.add_of(posed, moves, unknowns, rows, equations)

    def add_of(
        self,
        posed: PosedPoints,
        moves: tuple[Tensor, Tensor | None],
        unknowns: Unknowns,
        rows: slice,
        equations: NormalEquations,
    ) -> None:
        """Some frames' share of `add`, whose points are posed and move as `in_picture` says."""
        by_frame, by_subject = moves
        residuals, scaled, trust = self._residuals(unknowns, rows, posed.points)
        robust = trust / (1 + scaled.square().sum(dim=-1) / TAIL**2)
        equations.add(
            rows,
            by_frame.flatten(1, 2),
            None if by_subject is None else by_subject.flatten(1, 2),
            residuals.flatten(1),
            (robust * self.precision[rows]).repeat_interleave(2, dim=1),
        )

    def _residuals(self, unknowns: Unknowns, rows: slice, placed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Residuals (n, L, 2) in pixels, the same in standard deviations, and trust (n, L)."""
        pixels = self.view.project(self.view.in_camera(placed), unknowns.focal)
        residuals = pixels - self.landmarks.points[rows]
        scaled = residuals * self.precision[rows].sqrt()[..., None]
        facing = self.facing(unknowns, rows, placed)
        return residuals, scaled, self.landmarks.seen[rows] * self.trust * facing / ALIKE

    def facing(self, unknowns: Unknowns, rows: slice, placed: Tensor) -> Tensor:
        """(n, L) trust by which way the surface looks."""
        root = unknowns.layout.turn(0)
        turns = axis_angle_to_matrix(unknowns.frames[rows, root].to(placed.dtype))
        normals = self.normals @ turns.mT
        towards = torch.nn.functional.normalize(-self.view.in_camera(placed), dim=-1)
        towards = towards * towards.new_tensor([1.0, -1.0, -1.0])
        cosine = (normals * towards).sum(dim=-1)
        low, high = FACING
        return HIDDEN + (1 - HIDDEN) * ((cosine - low) / (high - low)).clamp(0.0, 1.0)


@dataclass(frozen=True, eq=False)
class GapTerm:
    """Squared differences between how far pairs of landmarks are apart in the picture, seen and on the head.

    Lids that touch in the picture touch on the head, whatever bias all of an eye's landmarks share.

    Attributes:
        term: The landmarks.
        upper: (G,) the pairs' first points, of the term's.
        lower: (G,) the pairs' second ones.
        gaps: (N, G, 2) pixels, as they are seen.
        trust: (N, G) trust in each.
        spread: Metres on the head, one standard deviation.
    """

    term: LandmarkTerm
    upper: Tensor
    lower: Tensor
    gaps: Tensor
    trust: Tensor
    spread: float

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the sum."""
        return sum(
            self.cost_of(pose(self.term.points, unknowns, rows), unknowns, rows)
            for rows in chunks(len(unknowns.frames))
        )

    def cost_of(self, posed: PosedPoints, unknowns: Unknowns, rows: slice) -> float:
        """Some frames' share of `cost`, whose points are posed."""
        residuals, weights = self._residuals(unknowns, rows, posed)
        return 0.5 * float((weights[..., None] * residuals.square()).double().sum())

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares."""
        for rows in chunks(len(unknowns.frames)):
            posed = pose(self.term.points, unknowns, rows)
            moves = in_picture(posed, self.term.view, unknowns, subject=equations.with_subject)
            self.add_of(posed, moves, unknowns, rows, equations)

    def add_of(
        self,
        posed: PosedPoints,
        moves: tuple[Tensor, Tensor | None],
        unknowns: Unknowns,
        rows: slice,
        equations: NormalEquations,
    ) -> None:
        """Some frames' share of `add`, whose points are posed and move as `in_picture` says."""
        by_frame, by_subject = moves
        residuals, weights = self._residuals(unknowns, rows, posed)
        equations.add(
            rows,
            self._differences(by_frame).flatten(1, 2),
            None if by_subject is None else self._differences(by_subject).flatten(1, 2),
            residuals.flatten(1),
            weights.repeat_interleave(2, dim=1),
        )

    def _differences(self, values: Tensor) -> Tensor:
        return values[:, self.upper] - values[:, self.lower]

    def _residuals(self, unknowns: Unknowns, rows: slice, posed: PosedPoints) -> tuple[Tensor, Tensor]:
        """Residuals (n, G, 2) in pixels, and weights (n, G) of their squares."""
        pixels = self.term.view.project(self.term.view.in_camera(posed.points), unknowns.focal)
        facing = self.term.facing(unknowns, rows, posed.points)
        facing = torch.minimum(facing[:, self.upper], facing[:, self.lower])
        weights = self.trust[rows] * facing * self.term.precision[rows] * (SPREAD / self.spread) ** 2
        return self._differences(pixels) - self.gaps[rows], weights


def chunks(frames: int, size: int = CHUNK) -> list[slice]:
    """The frames in pieces."""
    return [slice(first, min(first + size, frames)) for first in range(0, frames, size)]


def pose(points: SurfacePoints, unknowns: Unknowns, rows: slice) -> PosedPoints:
    """Points in some frames, in the points' precision."""
    dtype = points.joints.rest.dtype
    return points.pose(
        unknowns.parameters(rows).to(dtype=dtype), unknowns.shape.to(dtype), unknowns.offset.to(dtype)
    )


def in_picture(
    posed: PosedPoints, view: View, unknowns: Unknowns, *, subject: bool, slopes: Tensor | None = None
) -> tuple[Tensor, Tensor | None]:
    """How what is seen of points moves with what a fit solves for.

    Args:
        posed: L points in n frames.
        view: The camera.
        unknowns: The state.
        subject: Whether the subject moves, too.
        slopes: (n, L, R, 2) rows that pixels are multiplied by; None for the pixels themselves.

    Returns:
        (n, L, R, P) by a frame's own parameters, and (n, L, R, Q) by the subject's, the focal length's
        logarithm last, or None.
    """
    camera, focal = view.in_camera(posed.points), unknowns.focal
    x, y, z = camera.unbind(dim=-1)
    zero, scale = torch.zeros_like(z), focal / z
    across = torch.stack([scale, zero, scale * x / z], dim=-1)
    down = torch.stack([zero, -scale, scale * y / z], dim=-1)
    rows = torch.stack([across, down], dim=-2)
    by_focal = torch.stack([scale * x, scale * y], dim=-1)[..., None]
    if slopes is not None:
        rows, by_focal = slopes @ rows, slopes @ by_focal
    by_frame = posed.by_frame(rows)
    return by_frame, torch.cat([posed.by_subject(rows), by_focal], dim=-1) if subject else None
