"""Where a camera stands about a head: by yaw, pitch and distance, in the head's own axes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.geometry.camera import Camera
from samira_warp.head import PosedHead
from samira_warp.support.errors import UserError

NEAREST, FARTHEST = 0.25, 100.0
"""Metres from a head's centre to a camera: nearer it is in the hair, farther the head is a pixel or two."""

HIGHEST = 90.0
"""Degrees of pitch, straight above the head."""


class HeadPlace(NamedTuple):
    """Where a posed head is, and which way it looks.

    Attributes:
        center: (3,) its middle, metres, world space.
        axes: (3, 3) its own axes as columns, world space: its left, up, and where its face looks.
    """

    center: Tensor
    axes: Tensor

    @classmethod
    def of(cls, canonical: CanonicalHead, head: PosedHead) -> HeadPlace:
        """The place of one posed head: its axes are the world's where it is at rest."""
        motion = head.head_transform
        return cls(motion[:3, :3] @ head_center(canonical) + motion[:3, 3], motion[:3, :3])


class Viewpoint(NamedTuple):
    """A place from which a camera looks at a head's centre, the head's up above.

    Attributes:
        yaw: Degrees about the head's own vertical: 0 before the face, 90 at the head's left side.
        pitch: Degrees above the head's own horizontal, -90 to 90.
        distance: Metres to the head's centre.
    """

    yaw: float
    pitch: float
    distance: float

    def turned(self, degrees: float) -> Viewpoint:
        """The viewpoint so many degrees of yaw further."""
        return self._replace(yaw=self.yaw + degrees)

    def camera(self, place: HeadPlace, lens: Camera) -> Camera:
        """The camera at this viewpoint.

        Args:
            place: Where the head is.
            lens: A camera with the size and the focal lengths to take; the head's centre is in the middle of
                the picture, wherever this one has its principal point.
        """
        yaw, pitch = math.radians(self.yaw), math.radians(self.pitch)
        towards_camera = [math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)]
        up = [-math.sin(yaw) * math.sin(pitch), math.cos(pitch), -math.cos(yaw) * math.sin(pitch)]
        right = [math.cos(yaw), 0.0, -math.sin(yaw)]

        # OpenCV's axes are rows: right, down, forward; in float64, since a distance multiplies their rounding
        rows = torch.tensor([right, up, towards_camera], dtype=torch.float64)
        rows = rows * rows.new_tensor([[1.0], [-1.0], [-1.0]])
        rotation = rows @ place.axes.double().cpu().T
        world_to_camera = torch.eye(4, dtype=torch.float64)
        world_to_camera[:3, :3] = rotation
        world_to_camera[:3, 3] = -rotation @ place.center.double().cpu()
        world_to_camera[2, 3] += self.distance
        return replace(
            lens,
            world_to_camera=world_to_camera.to(lens.world_to_camera),
            cx=0.5 * lens.width,
            cy=0.5 * lens.height,
        )


class Orbit(NamedTuple):
    """A camera that goes once about a head, at one height, its yaw rising.

    Attributes:
        seconds: Of one turn.
        start: Where it begins and ends.
        place: Where the head is.
        lens: As `Viewpoint.camera` takes it.
    """

    seconds: float
    start: Viewpoint
    place: HeadPlace
    lens: Camera

    def camera(self, degrees: float) -> Camera:
        """The camera so many degrees of yaw from the start."""
        return self.start.turned(degrees).camera(self.place, self.lens)


def head_center(canonical: CanonicalHead) -> Tensor:
    """(3,) the middle of the box about what the head's joint carries, at rest: skull, face, jaw and eyes."""
    rig = canonical.rig
    carried = [rig.joint(rig.head_joint)]
    for joint, parent in enumerate(rig.parents):
        if parent in carried:
            carried.append(joint)
    vertices = canonical.vertices[rig.weights[:, carried].sum(dim=1) > 0.5]
    return 0.5 * (vertices.amin(dim=0) + vertices.amax(dim=0))


def distance_to(camera: Camera, place: HeadPlace) -> float:
    """Metres from a camera to a head's centre."""
    return float((camera.center.to(place.center) - place.center).norm())


def parse_viewpoint(text: str) -> tuple[float, float, float | None]:
    """Yaw, pitch and distance of ``--camera``; the distance is None where it is left out.

    Raises:
        UserError: It is not of that form, or a number is out of its range.
    """
    expected = (
        f"YAW,PITCH or YAW,PITCH,DISTANCE: degrees, degrees from {-HIGHEST:g} to {HIGHEST:g}, "
        f"metres from {NEAREST:g} to {FARTHEST:g}"
    )
    try:
        yaw, pitch, *more = [float(word) for word in text.split(",")]
        if len(more) > 1:
            raise ValueError
    except ValueError:
        raise UserError("--camera", expected=expected, found=repr(text)) from None
    distance = more[0] if more else None
    fits = math.isfinite(yaw) and -HIGHEST <= pitch <= HIGHEST
    if not fits or not (distance is None or NEAREST <= distance <= FARTHEST):
        raise UserError("--camera", expected=expected, found=repr(text))
    return yaw, pitch, distance
