"""Outlines as a term of a fit: how far the head ends from where the matte ends, along the outline's normal.

Hair, ears and clothes go beyond the head that is tracked, so that its outline never is the matte's. What
tells is how the distance between the two changes: about a head that is held too far away it has grown all
around, which neither landmarks nor colours see as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.tracker.landmark_terms import chunks, in_picture, pose
from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.observed import DISTANCE, View
from samira_warp.tracker.photometric import grid_of, sample
from samira_warp.tracker.render_fit import BELOW_CHIN
from samira_warp.tracker.samples import Samples
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.surface_points import SurfacePoints
from samira_warp.tracker.unknowns import Unknowns

POINTS = 1500
"""Points of the surface, of which a tenth is at the outline in a frame."""

DENSITY = {
    **dict.fromkeys(("lips", "left_eye", "right_eye", "nose", "cheeks", "forehead", "ears", "scalp"), 1.0),
    **dict.fromkeys(("neck", "mouth"), 0.0),
}
"""Points for an area, by region. A neck ends in clothes."""

EDGE_ON = 0.25
"""Cosine of normal and view up to which a point may be at the outline: it is 3 % of the surface's radius
inside it at most."""

REACH = 0.05
"""Of the longer side: how far from a point outlines are looked for."""

ON_OUTLINE = 0.016
"""Of the longer side: how far the mesh's outline may be from a point that is said to be at it."""

STEPS = 41
"""Places along the normal at which coverage is read: half a pixel of 192 apart."""

SPREAD = 0.0026
"""Of the longer side, by which the distance of outlines is otherwise than known, one standard deviation: half
a pixel of 192."""

TAIL = 2.5
"""Standard deviations beyond which hair or a hand has moved (Cauchy)."""

ALIKE = 8.0
"""Neighbouring points err together: so many count as one."""

CHUNK = 8
"""Frames at once."""


class Outlines(NamedTuple):
    """Points of a surface that are at its outline in N frames.

    Attributes:
        pixels: (N, S, 2) where the points are.
        normals: (N, S, 2) unit, outwards.
        distances: (N, S) pixels from the mesh's outline outwards to the matte's; NaN where a point is not at
            the mesh's, or the matte has none near.
    """

    pixels: Tensor
    normals: Tensor
    distances: Tensor


@dataclass(frozen=True, eq=False)
class OutlineTerm:
    """Squared differences between how far outlines are apart and how far they are known to be, Cauchy's way.

    Attributes:
        points: S points of the surface.
        view: The camera.
        outlines: Where the points were, and how far from the matte's outline.
        known: (S,) pixels that they are known to be from it.
    """

    points: SurfacePoints
    view: View
    outlines: Outlines
    known: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the robust sum."""
        total = 0.0
        for rows in chunks(len(unknowns.frames), CHUNK):
            placed = pose(self.points, unknowns, rows).points
            scaled, seen = self._residuals(placed, unknowns, rows)
            rho = TAIL**2 * torch.log1p(scaled.square() / TAIL**2)
            total += 0.5 * float((seen * rho).double().sum()) / ALIKE
        return total

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares, weighted as Cauchy's function grows there."""
        for rows in chunks(len(unknowns.frames), CHUNK):
            posed = pose(self.points, unknowns, rows)
            scaled, seen = self._residuals(posed.points, unknowns, rows)
            robust = seen / (1 + scaled.square() / TAIL**2) / ALIKE
            slopes = (self.outlines.normals[rows] / self._spread)[:, :, None]
            by_frame, by_subject = in_picture(
                posed, self.view, unknowns, subject=equations.with_subject, slopes=slopes
            )
            equations.add(
                rows,
                by_frame.flatten(1, 2),
                None if by_subject is None else by_subject.flatten(1, 2),
                scaled,
                robust,
            )

    @property
    def _spread(self) -> float:
        return SPREAD * longer_side(self.view)

    def _residuals(self, placed: Tensor, unknowns: Unknowns, rows: slice) -> tuple[Tensor, Tensor]:
        """(n, S) standard deviations that points are too far out, and 1 where they are at an outline."""
        pixels = self.view.project(self.view.in_camera(placed), unknowns.focal)
        went = ((pixels - self.outlines.pixels[rows]) * self.outlines.normals[rows]).sum(dim=-1)
        missing = self.outlines.distances[rows] - self.known
        seen = ~missing.isnan()
        return (went - missing.nan_to_num()) / self._spread, seen.to(went.dtype)


@dataclass(frozen=True, eq=False)
class OutlineFinder:
    """Looks up outlines of a head.

    Attributes:
        head: The head.
        view: The camera, at the frames' own size.
        samples: Points of the head.
    """

    head: TrackedHead
    view: View
    samples: Samples

    @classmethod
    def build(cls, head: TrackedHead, view: View) -> OutlineFinder:
        """Scatter points over a head."""
        return cls(head, view, Samples.build(head, count=POINTS, density=DENSITY))

    def find(self, vertices: Tensor, mattes: Tensor, *, focal: float) -> Outlines:
        """Look for the outlines of n frames.

        Args:
            vertices: (n, V, 3) metres in the world, as they are posed.
            mattes: (n, h, w) uint8 coverage.
            focal: Focal length, pixels of the view.
        """
        points = self.samples.of(vertices)
        facing = torch.nn.functional.normalize(
            self.samples.of(mesh_normals(vertices, self._topology)), dim=-1
        )
        towards = torch.nn.functional.normalize(points.new_tensor([0.0, 0.0, DISTANCE]) - points, dim=-1)
        edge_on = (facing * towards).sum(dim=-1).abs() < EDGE_ON
        pixels = self._project(points, focal)
        normals = torch.nn.functional.normalize(facing[..., :2] * facing.new_tensor([1.0, -1.0]), dim=-1)
        reach = REACH * longer_side(self.view)
        mine = crossing(self._coverage(vertices, mattes, focal), pixels, normals, self.view, reach=reach)
        theirs = crossing(mattes.float() / 255.0, pixels, normals, self.view, reach=reach)
        counts = edge_on & (mine.abs() < ON_OUTLINE * longer_side(self.view))
        counts &= pixels[..., 1] < self._end(vertices, focal)[:, None]
        return Outlines(pixels, normals, torch.where(counts, theirs - mine, torch.nan))

    @cached_property
    def _topology(self) -> MeshTopology:
        return MeshTopology.build(self.head.faces, len(self.head.rig.v_template))

    @cached_property
    def _face(self) -> Tensor:
        every = np.arange(len(self.head.template.v_template))
        return torch.from_numpy(self.head.template.masks.get("face", every)).long()

    def _project(self, points: Tensor, focal: float) -> Tensor:
        return self.view.project(self.view.in_camera(points), focal)

    def _coverage(self, vertices: Tensor, mattes: Tensor, focal: float) -> Tensor:
        """(n, h, w) of the mesh, antialiased."""
        height, width = mattes.shape[1:]
        depth = self.view.in_camera(vertices)[..., 2:]
        points = torch.cat([self._project(vertices, focal) * (width / self.view.width), depth], dim=-1)
        raster = rasterize_mesh(points, self._topology, width=width, height=height)
        whole = interpolate(torch.ones_like(depth), raster, self._topology)
        return antialias(whole, raster, points, self._topology)[..., 0]

    def _end(self, vertices: Tensor, focal: float) -> Tensor:
        """(n,) pixels from the upper edge where outlines stop counting, below the chin."""
        face = self._project(vertices[:, self._face], focal)[..., 1]
        low, high = face.amin(dim=1), face.amax(dim=1)
        return high + BELOW_CHIN * (high - low)


def longer_side(view: View) -> int:
    """Pixels of the pictures' longer side."""
    return max(view.width, view.height)


def usual_distances(outlines: Outlines) -> Tensor:
    """(S,) median over the frames of how far outlines are apart; NaN for points that never are at one."""
    return outlines.distances.nanmedian(dim=0).values


def join(parts: list[Outlines]) -> Outlines:
    """The outlines of frames that were looked at in parts."""
    return Outlines(*(torch.cat(part) for part in zip(*parts, strict=True)))


def crossing(coverage: Tensor, pixels: Tensor, normals: Tensor, view: View, *, reach: float) -> Tensor:
    """Where coverage falls below a half along normals, as near as there is.

    Args:
        coverage: (n, h, w) in 0..1, of the view's picture at any size.
        pixels: (n, S, 2) where to begin, pixels of the view.
        normals: (n, S, 2) unit directions.
        view: The camera.
        reach: Pixels to look for it, either way.

    Returns:
        (n, S) signed pixels along the normal; NaN where it does not fall within reach.
    """
    places = torch.linspace(-reach, reach, STEPS)
    grid = grid_of((pixels[:, :, None] + places[:, None] * normals[:, :, None]).flatten(1, 2), view)
    values = sample(coverage[:, None], grid)[..., 0].unflatten(1, (pixels.shape[1], STEPS))
    here, there = values[..., :-1], values[..., 1:]
    share = (here - 0.5) / (here - there).clamp(min=1e-6)
    at = torch.where((here >= 0.5) & (there < 0.5), places[:-1] + share * places.diff(), torch.inf)
    nearest = at.gather(-1, at.abs().argmin(dim=-1, keepdim=True))[..., 0]
    return torch.where(nearest.isinf(), torch.nan, nearest)
