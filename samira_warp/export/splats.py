"""One frame's Gaussians as other programs know them: in world space, each with one colour."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import normalize

from samira_warp.avatar import Avatar, DrivingFrame, Motion
from samira_warp.geometry.camera import Camera
from samira_warp.light import FilteredLight, shade


class Splats(NamedTuple):
    """N Gaussians.

    Attributes:
        means: (N, 3) metres, world space.
        normals: (N, 3) unit.
        quaternions: (N, 4) w, x, y, z.
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


def frame_splats(avatar: Avatar, frame: DrivingFrame, light: FilteredLight | None) -> Splats:
    """The Gaussians of a frame, after binding and residual.

    Args:
        avatar: The avatar.
        frame: Pose, expression and camera, on the avatar's device.
        light: What lights them, there as well; None leaves them the colour of their albedo.
    """
    motion = avatar.move(frame.parameters)
    moved, own = motion.gaussians, avatar.gaussians
    colors = avatar.display(own.albedo) if light is None else _lit(avatar, motion, frame.camera, light)
    return Splats(moved.means, moved.normals, moved.quaternions, moved.scales, own.opacity_logits, colors)


def _lit(avatar: Avatar, motion: Motion, camera: Camera, light: FilteredLight) -> Tensor:
    """(N, 3) what a camera sees of every Gaussian, none of which hides another; the head casts shadows."""
    view = normalize(camera.center - motion.gaussians.means, dim=1)
    arrival = avatar.arrival(avatar.occluder.occlude(motion.head), light, camera)
    surface = avatar.surface(motion, arrival=arrival)
    return shade(surface, view, light, color_space=avatar.settings.color_space).image
