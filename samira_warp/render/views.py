"""The cameras to render by: the frames' own, or one that the options place about the head."""

from __future__ import annotations

import sys
from typing import NamedTuple

from samira_warp.avatar import Avatar, DrivingFrame
from samira_warp.render.config import RenderConfig
from samira_warp.stage.viewpoint import HeadPlace, Orbit, Viewpoint, distance_to, parse_viewpoint

LARGEST_SCALE = 2.0
"""How many times as large as in training a head may be drawn without a warning: a Gaussian that was fitted to
pixels stands for what is between them by its shape alone."""


class Views(NamedTuple):
    """Who looks at what.

    Attributes:
        frames: The frames, their cameras those to render by.
        orbit: A camera that goes round instead; None where none does.
        scale: How many times as large as in training a head as far away as its own camera's is drawn.
    """

    frames: list[DrivingFrame]
    orbit: Orbit | None
    scale: float


def place_cameras(
    config: RenderConfig, avatar: Avatar, frames: list[DrivingFrame], trained: DrivingFrame
) -> Views:
    """The frames before the cameras that the options ask for.

    Args:
        config: The options.
        avatar: On its device.
        frames: As they were selected, at the size to render them.
        trained: A frame that the avatar was made from: its camera is the training camera.

    Raises:
        UserError: --camera is not of its form.
    """
    camera = trained.camera
    longer = max(frames[0].camera.width, frames[0].camera.height)
    scale = longer / max(camera.width, camera.height)
    if config.fov is not None:
        zoomed = camera.with_field_of_view(config.fov)
        scale *= zoomed.fx / camera.fx
        camera = zoomed
    if config.camera is None and config.orbit is None:
        if config.fov is not None:
            frames = [frame._replace(camera=frame.camera.with_field_of_view(config.fov)) for frame in frames]
        return Views(frames, None, scale)

    yaw, pitch, distance = parse_viewpoint(config.camera or "0,0")
    usual = distance_to(camera, _place(avatar, trained))
    viewpoint = Viewpoint(yaw, pitch, usual if distance is None else distance)
    place, lens = _place(avatar, frames[0]), camera.with_longer_side(longer)
    placed = viewpoint.camera(place, lens)
    orbit = None if config.orbit is None else Orbit(config.orbit, viewpoint, place, lens)
    return Views(
        [frame._replace(camera=placed) for frame in frames], orbit, scale * (usual / viewpoint.distance)
    )


def warn_of_enlargement(scale: float, trained: DrivingFrame) -> None:
    """Say so where heads are drawn much larger than training showed them."""
    if scale > LARGEST_SCALE:
        size = f"{trained.camera.width} x {trained.camera.height}"
        print(
            f"warning: the head is drawn {scale:.1f} times as large as in its training pictures ({size}): "
            f"beyond {LARGEST_SCALE:g} times there is no more to see, and single Gaussians show",
            file=sys.stderr,
        )


def _place(avatar: Avatar, frame: DrivingFrame) -> HeadPlace:
    """Where the head of a frame is."""
    device = avatar.canonical.vertices.device
    return HeadPlace.of(avatar.canonical, avatar.canonical.pose(frame.parameters.to(device)))
