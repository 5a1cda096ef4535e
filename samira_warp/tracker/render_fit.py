"""The subject refined by rendering: colours inside the mesh, and its silhouette against the mattes.

Key frames are rasterised, shaded and compared, from coarse to fine, and all that they hang on follows the
gradient: identity, offset, albedo, light, and a little the frames themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.light.color import encode_srgb
from samira_warp.light.harmonics import irradiance_functions
from samira_warp.tracker.landmark_fit import LandmarkModel
from samira_warp.tracker.landmark_terms import ALIKE, TAIL
from samira_warp.tracker.observed import View
from samira_warp.tracker.priors import subject_term
from samira_warp.tracker.unknowns import Unknowns

BATCH = 8
"""Frames to a step."""

LEVELS = ((96, 50), (192, 60))
"""Pixels of the longer side, and steps, from coarse to fine."""

RATES = {
    "subject": 0.06,
    "translation": 2e-4,
    "turns": 1e-3,
    "expression": 4e-3,
    "albedo": 6e-3,
    "light": 6e-3,
}
"""Adam's: of the subject in standard deviations of what is known of it, of frames in metres, radians and
coefficients, of albedo in its logarithm."""

COLOR_SPREAD = 0.05
"""Display values by which a pixel looks otherwise, one standard deviation."""

PIXELS_ALIKE = 16.0
"""Neighbouring pixels err together: so many count as one."""

OUTLINE_WEIGHT = 0.25
"""Of a pixel along an outline, in pictures of 192, that the mesh covers and the matte does not, or the other
way round."""

REACH = 0.08
"""Of the picture's longer side: a matte that ends farther beyond the mesh is of hair or clothes, and pulls at
nothing."""

BELOW_CHIN = 0.15
"""Of the face's height: so far below the chin outlines stop counting. Collars begin there."""

FRAME_HOLD = {"translation": 0.002, "turns": 0.01, "expression": 0.1}
"""How far frames may go from where the landmarks had them, one standard deviation: metres, radians,
coefficients."""

LEAST_IRRADIANCE = 1e-3
"""Harmonics of nine coefficients may be negative where a light is all on one side."""


class KeyFrames(NamedTuple):
    """Frames that the subject is refined from.

    Attributes:
        pictures: (K, H, W, 3) uint8 display values, at the finest level.
        mattes: (K, H, W) uint8 coverage.
        landmarks: (K, L, 2) float32 pixels of the view.
        precision: (K, L) float32 inverse variances of the landmarks, per square pixel.
    """

    pictures: Tensor
    mattes: Tensor
    landmarks: Tensor
    precision: Tensor


class Rendered(NamedTuple):
    """A subject as it is rendered.

    Attributes:
        unknowns: Subject and key frames.
        albedo: (V, 3) float32 linear, positive.
        light: (9, 3) float32 spherical harmonics of radiance, in the world.
    """

    unknowns: Unknowns
    albedo: Tensor
    light: Tensor


def refine_by_rendering(
    model: LandmarkModel, start: Rendered, keys: KeyFrames, view: View, *, say: Callable[[str], None]
) -> Rendered:
    """Refine a subject.

    Args:
        model: Landmarks on the head.
        start: Where to begin.
        keys: K frames.
        view: The camera, at the frames' own size.
        say: Told of progress.
    """
    variables = _Variables(model, start)
    optimizer = torch.optim.Adam(variables.groups(), betas=(0.9, 0.95))
    batches = [slice(first, first + BATCH) for first in range(0, len(keys.pictures), BATCH)]
    renderer = _Renderer.build(model, view)
    for side, steps in LEVELS:
        level = _Level.build(keys, view, side)
        for step in range(steps):
            rows = batches[step % len(batches)]
            loss = renderer.loss(variables, keys, level, rows)
            optimizer.zero_grad(set_to_none=True)
            loss.total.backward()
            optimizer.step()
        say(f"head rendered at {side} pixels: {loss}")
    return variables.result()


class _Variables:
    """What the gradient moves, about where it began."""

    def __init__(self, model: LandmarkModel, start: Rendered) -> None:
        self._start, layout = start.unknowns, start.unknowns.layout
        frames = len(self._start.frames)
        spread = subject_term(model.head, focal=self._start.focal, frames=1).weights.rsqrt()
        self._spread = spread.float()
        self._from_mean = (self._start.subject / spread).float()
        self._from_mean[-1] = 0.0  # the focal length's is measured from where it is
        hold = torch.full((layout.frame_size,), FRAME_HOLD["turns"])
        hold[layout.translation], hold[layout.expression] = (
            FRAME_HOLD["translation"],
            FRAME_HOLD["expression"],
        )
        self._hold = hold
        sizes = {"translation": 3, "turns": 3 * len(layout.moving), "expression": layout.expressions}
        self._moves = {name: torch.zeros(frames, size, requires_grad=True) for name, size in sizes.items()}
        self._subject = torch.zeros(layout.subject_size, requires_grad=True)
        self._log_albedo = start.albedo.clamp(min=1e-3).log().requires_grad_()
        self.light = start.light.clone().requires_grad_()

    def groups(self) -> list[dict[str, Any]]:
        """For Adam."""
        named = {**self._moves, "subject": self._subject, "albedo": self._log_albedo, "light": self.light}
        return [{"params": [values], "lr": RATES[name]} for name, values in named.items()]

    @property
    def albedo(self) -> Tensor:
        """(V, 3)."""
        return self._log_albedo.exp()

    def _moved(self, rows: slice) -> Tensor:
        """(n, P) how far some frames have gone."""
        return torch.cat([move[rows] for move in self._moves.values()], dim=1)

    def unknowns(self, rows: slice = slice(None)) -> Unknowns:
        """The state of some frames, differentiable."""
        subject = self._start.subject + self._subject * self._spread
        return replace(self._start, frames=self._start.frames[rows] + self._moved(rows), subject=subject)

    def known(self, rows: slice) -> Tensor:
        """How unlikely the subject is, and how far some frames have gone: a negative logarithm."""
        moved = (self._moved(rows) / self._hold).square().sum() / max(len(self._moved(rows)), 1)
        return 0.5 * ((self._from_mean + self._subject).square().sum() + moved)

    def result(self) -> Rendered:
        """What was reached."""
        with torch.no_grad():
            found = self.unknowns()
            return Rendered(
                replace(found, frames=found.frames.detach(), subject=found.subject.detach()),
                self.albedo.detach(),
                self.light.detach(),
            )


class _Level(NamedTuple):
    """Key frames at one size.

    Attributes:
        pictures: (K, h, w, 3) display values.
        mattes: (K, h, w) coverage.
        missed: (K, h, w) how much a pixel counts that the matte covers and the mesh does not.
    """

    pictures: Tensor
    mattes: Tensor
    missed: Tensor

    @classmethod
    def build(cls, keys: KeyFrames, view: View, side: int) -> _Level:
        scale = side / max(view.width, view.height)
        size = (round(view.height * scale), round(view.width * scale))

        def small(values: Tensor) -> Tensor:
            return torch.nn.functional.interpolate(values.float() / 255.0, size, mode="area")

        mattes = small(keys.mattes[:, None])[:, 0]
        inside = np.stack([distance_transform_edt(matte > 0.5) for matte in mattes.numpy()])
        missed = torch.exp(-torch.from_numpy(inside / (REACH * side)).float().square())
        return cls(small(keys.pictures.permute(0, 3, 1, 2)).permute(0, 2, 3, 1), mattes, missed)


class _Loss(NamedTuple):
    """Negative logarithms of how likely a state is, for one frame."""

    colors: Tensor
    outlines: Tensor
    landmarks: Tensor
    known: Tensor

    @property
    def total(self) -> Tensor:
        return self.colors + self.outlines + self.landmarks + self.known

    def __str__(self) -> str:
        return ", ".join(f"{name} {value.item():.1f}" for name, value in self._asdict().items())


@dataclass(frozen=True, eq=False)
class _Renderer:
    """The head as it is drawn."""

    model: LandmarkModel
    topology: MeshTopology
    face: Tensor
    view: View

    @classmethod
    def build(cls, model: LandmarkModel, view: View) -> _Renderer:
        head = model.head
        face = head.template.masks.get("face", np.arange(len(head.template.v_template)))
        topology = MeshTopology.build(head.faces, len(head.rig.v_template))
        return cls(model, topology, torch.from_numpy(face).long(), view)

    def loss(self, variables: _Variables, keys: KeyFrames, level: _Level, rows: slice) -> _Loss:
        """The loss of some frames."""
        unknowns, head = variables.unknowns(rows), self.model.head
        offset = head.basis @ unknowns.offset.float()
        vertices = head.rig.pose(
            unknowns.parameters().to(dtype=torch.float32), unknowns.shape.float(), offset
        ).vertices
        camera = self.view.in_camera(vertices)
        pixels = self.view.project(camera, unknowns.subject[-1].exp().float())
        frames, height, width = level.mattes[rows].shape
        scale = width / self.view.width
        image = self._draw(
            variables, vertices, torch.cat([pixels * scale, camera[..., 2:]], dim=-1), width, height
        )
        above = self._above_neck(pixels.detach(), scale, height)
        return _Loss(
            colors=_colors(image, level, rows) / frames,
            outlines=_outlines(image[..., 3], level, rows, above) / frames,
            landmarks=self._landmarks(pixels, keys, rows) / frames,
            known=variables.known(rows),
        )

    def _draw(
        self, variables: _Variables, vertices: Tensor, points: Tensor, width: int, height: int
    ) -> Tensor:
        """(n, h, w, 4) display values and coverage, with antialiased outlines."""
        raster = rasterize_mesh(points, self.topology, width=width, height=height)
        normals = mesh_normals(vertices, self.topology)
        irradiance = (irradiance_functions(normals) @ variables.light).clamp(min=LEAST_IRRADIANCE)
        shown = encode_srgb(variables.albedo * irradiance)
        shown = torch.cat([shown, torch.ones_like(shown[..., :1])], dim=-1)
        return antialias(interpolate(shown, raster, self.topology), raster, points, self.topology)

    def _landmarks(self, pixels: Tensor, keys: KeyFrames, rows: slice) -> Tensor:
        placed = (pixels[:, self.model.corners] * self.model.barycentrics[..., None]).sum(dim=2)
        return _robust((placed - keys.landmarks[rows]).square().sum(dim=-1) * keys.precision[rows]) / ALIKE

    def _above_neck(self, pixels: Tensor, scale: float, height: int) -> Tensor:
        """(n, h, 1) 1 for rows above the neck, of (n, V, 2) pixels of the view."""
        face = pixels[:, self.face, 1] * scale
        low, high = face.amin(dim=1), face.amax(dim=1)
        end = high + BELOW_CHIN * (high - low)
        return (torch.arange(height)[None, :, None] + 0.5 < end[:, None, None]).float()


def _colors(image: Tensor, level: _Level, rows: slice) -> Tensor:
    inside = (image[..., 3].detach() > 0.99) & (level.mattes[rows] > 0.9)
    squared = (image[..., :3] - level.pictures[rows]).square().sum(dim=-1) / COLOR_SPREAD**2
    return _robust(squared * inside) / PIXELS_ALIKE


def _outlines(covered: Tensor, level: _Level, rows: slice, above: Tensor) -> Tensor:
    matte = level.mattes[rows]
    counts = torch.where(matte > covered.detach(), level.missed[rows], 1.0) * above
    return OUTLINE_WEIGHT * (192 / max(covered.shape[1:])) * (counts * (covered - matte).abs()).sum()


def _robust(squared: Tensor) -> Tensor:
    """Half the sum of Cauchy's function of squares in standard deviations."""
    return 0.5 * TAIL**2 * torch.log1p(squared / TAIL**2).sum()
