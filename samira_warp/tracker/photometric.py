"""Colours as a term of a fit: points of the surface look in every picture as they are known to look."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from samira_warp.tracker.landmark_terms import chunks, in_picture, pose
from samira_warp.tracker.normal_equations import NormalEquations
from samira_warp.tracker.observed import View
from samira_warp.tracker.surface_points import SurfacePoints
from samira_warp.tracker.unknowns import Unknowns

CHUNK = 8
"""Frames at once: of 2,400 points, 30 MB of derivatives by frame."""

COLOR_SPREAD = 0.03
"""Display values by which a point looks otherwise than is known, one deviation: shine, shadows, pores."""

TAIL = 2.5
"""Standard deviations beyond which a difference is taken for something in the way (Cauchy)."""

ALIKE = 12.0
"""Neighbouring points look wrong together: so many count as one."""


@dataclass(frozen=True, eq=False)
class PhotometricTerm:
    """Squared differences of display values, Cauchy's way.

    Attributes:
        points: S points of the surface.
        pictures: (N, H, W, 3) uint8 display values, at one level of a pyramid.
        view: The camera, at the frames' own size.
        predicted: (N, S, 3) display values that the points are known to have.
        weights: (N, S) trust in each point, 0 where it is hidden.
        spread: (S,) or () display values, one standard deviation.
    """

    points: SurfacePoints
    pictures: Tensor
    view: View
    predicted: Tensor
    weights: Tensor
    spread: Tensor

    def cost(self, unknowns: Unknowns) -> float:
        """Half of the robust sum."""
        total = 0.0
        for rows in chunks(len(unknowns.frames), CHUNK):
            pixels = self._pixels(pose(self.points, unknowns, rows).points, unknowns)
            scaled = (sample(planes(self.pictures[rows]), self._grid(pixels)) - self.predicted[rows]) / (
                self.spread[..., None]
            )
            squared = scaled.square().sum(dim=-1)
            rho = TAIL**2 * torch.log1p(squared / TAIL**2)
            total += 0.5 * float((self.weights[rows] * rho).double().sum()) / ALIKE
        return total

    def add(self, unknowns: Unknowns, equations: NormalEquations) -> None:
        """Add the squares, weighted as Cauchy's function grows there."""
        for rows in chunks(len(unknowns.frames), CHUNK):
            posed = pose(self.points, unknowns, rows)
            grid = self._grid(self._pixels(posed.points, unknowns))
            images = planes(self.pictures[rows])
            across, down = slopes(images, self.pictures.shape[2] / self.view.width)
            residuals = (sample(images, grid) - self.predicted[rows]) / self.spread[..., None]
            gradient = torch.stack([sample(across, grid), sample(down, grid)], dim=-1)
            robust = self.weights[rows] / (1 + residuals.square().sum(dim=-1) / TAIL**2) / ALIKE
            # three colours say of two directions what two numbers say: rows of a triangular root
            root, reduced = _two_rows(gradient / self.spread[..., None, None], residuals)
            by_frame, by_subject = in_picture(
                posed, self.view, unknowns, subject=equations.with_subject, slopes=root
            )
            equations.add(
                rows,
                by_frame.flatten(1, 2),
                None if by_subject is None else by_subject.flatten(1, 2),
                reduced.flatten(1),
                robust.repeat_interleave(2, dim=1),
            )

    def _pixels(self, placed: Tensor, unknowns: Unknowns) -> Tensor:
        return self.view.project(self.view.in_camera(placed), unknowns.focal)

    def _grid(self, pixels: Tensor) -> Tensor:
        return grid_of(pixels, self.view)


def grid_of(pixels: Tensor, view: View) -> Tensor:
    """(n, 1, S, 2) where `grid_sample` finds (n, S, 2) pixels of a view, whatever the picture's size."""
    return (2 * pixels / pixels.new_tensor([view.width, view.height]) - 1)[:, None]


def planes(pictures: Tensor) -> Tensor:
    """(n, 3, H, W) display values of (n, H, W, 3) uint8."""
    return pictures.permute(0, 3, 1, 2).float() / 255.0


def sample(images: Tensor, grid: Tensor) -> Tensor:
    """(n, S, C) bilinear values of (n, C, H, W), the border's beyond it."""
    found = torch.nn.functional.grid_sample(images, grid, align_corners=False, padding_mode="border")
    return found[:, :, 0].mT


def slopes(images: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Central differences (n, C, H, W) along x and y, by pixels of a picture `scale` times smaller."""
    padded = torch.nn.functional.pad(images, (1, 1, 1, 1), mode="replicate")
    across = 0.5 * scale * (padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2])
    down = 0.5 * scale * (padded[:, :, 2:, 1:-1] - padded[:, :, :-2, 1:-1])
    return across, down


def _two_rows(gradient: Tensor, residuals: Tensor) -> tuple[Tensor, Tensor]:
    """(..., 2, 2) rows and (..., 2) residuals with the squares of (..., 3, 2) rows and (..., 3) residuals.

    But for a constant; by Cholesky's root of the 2 x 2 matrix, held off singularity.
    """
    matrix = gradient.mT @ gradient
    right = (gradient.mT @ residuals[..., None])[..., 0]
    tiny = 1e-6 + 1e-4 * (matrix[..., 0, 0] + matrix[..., 1, 1])
    a = (matrix[..., 0, 0] + tiny).sqrt()
    b = matrix[..., 0, 1] / a
    c = (matrix[..., 1, 1] + tiny - b * b).clamp(min=1e-12).sqrt()
    zero = torch.zeros_like(a)
    root = torch.stack([torch.stack([a, b], dim=-1), torch.stack([zero, c], dim=-1)], dim=-2)
    first = right[..., 0] / a
    second = (right[..., 1] - b * first) / c
    return root, torch.stack([first, second], dim=-1)
