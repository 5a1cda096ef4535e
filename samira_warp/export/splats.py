"""One frame's Gaussians as other programs know them: in world space, each with one colour."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import normalize

from samira_warp.avatar import DrivingFrame, Motion
from samira_warp.export.source import ExportSource
from samira_warp.geometry.camera import Camera
from samira_warp.light import FilteredLight, shade, to_display

SH_DEGREE_0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi)): viewers show 0.5 + SH_DEGREE_0 times its coefficient."""


class Splats(NamedTuple):
    """N Gaussians.

    Attributes:
        means: (N, 3) metres, world space: x to the head's left, y up, z to the front.
        normals: (N, 3) unit.
        quaternions: (N, 4) unit; w, x, y, z.
        scales: (N, 3) standard deviations, metres.
        opacity_logits: (N,) opacities before the sigmoid.
        colors: (N, 3) display values, not clipped.
    """

    means: Tensor
    normals: Tensor
    quaternions: Tensor
    scales: Tensor
    opacity_logits: Tensor
    colors: Tensor

    @property
    def harmonics(self) -> Tensor:
        """(N, 3) coefficients of degree 0 for the colours."""
        return (self.colors - 0.5) / SH_DEGREE_0

    @property
    def opacities(self) -> Tensor:
        """(N,) opacities, 0 to 1."""
        return self.opacity_logits.sigmoid()


def frame_splats(source: ExportSource, frame: DrivingFrame) -> Splats:
    """The Gaussians of a frame, after binding and residual, in the colours that its camera sees."""
    avatar = source.avatar
    motion = avatar.move(frame.parameters)
    moved, own = motion.gaussians, avatar.gaussians
    light = source.filtered
    colors = avatar.display(own.albedo) if light is None else _lit(source, motion, frame.camera, light)
    return Splats(
        moved.means,
        moved.normals,
        normalize(moved.quaternions, dim=1),
        moved.scales,
        own.opacity_logits,
        colors,
    )


def _lit(source: ExportSource, motion: Motion, camera: Camera, light: FilteredLight) -> Tensor:
    """(N, 3) what a camera sees of every Gaussian, none of which hides another."""
    avatar = source.avatar
    view = normalize(camera.center - motion.gaussians.means, dim=1)
    arrival = None
    if source.shadows:
        arrival = avatar.arrival(avatar.occluder.occlude(motion.head), light, camera)
    surface = avatar.surface(motion, arrival=arrival)
    color_space = avatar.settings.color_space
    radiance = shade(surface, view, light, color_space=color_space).color
    return to_display(radiance, color_space=color_space, tone_map=source.tone_map)
