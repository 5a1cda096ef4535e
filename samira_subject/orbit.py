"""The head filmed from all around: where the cameras of `gt/orbit` stand, and the poses that it holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from samira_subject.gestures import BLINK
from samira_subject.performance import JAW, Performance
from samira_subject.studio import DISTANCE
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters

POSES = ("neutral", "expression")
"""What is held: the performance's first frame, and the test frame whose mouth is open widest under open eyes,
its head turned back to look ahead."""


class View(NamedTuple):
    """From where a camera looks at the middle of the head.

    Attributes:
        yaw: Degrees from straight before the face (+z) towards the subject's left (+x).
        pitch: Degrees above the horizon.
    """

    yaw: int
    pitch: int


AROUND = tuple(View(yaw, 0) for yaw in (0, 45, -45, 90, -90, 135, -135, 180))
VIEWS = (*AROUND, View(0, 40), View(90, 40), View(180, 40), View(0, -25), View(-90, -25))
"""The cameras of each pose: all around, from above, and from as far below as shows no inside of the neck."""


def view_name(pose: int, view: View) -> str:
    """What the files of a picture are called, without their suffix: neutral_yaw-045_pitch+00."""
    return f"{POSES[pose]}_yaw{view.yaw:+04d}_pitch{view.pitch:+03d}"


def orbit_camera(camera: Camera, view: View) -> Camera:
    """The camera, which looks straight at the face, taken round what it looks at."""
    before = camera.world_to_camera.double()
    around = torch.linalg.inv(before) @ before.new_tensor([0.0, 0.0, DISTANCE, 1.0])
    to_middle = torch.eye(4, dtype=torch.float64)
    to_middle[:3, 3] = -around[:3]
    yaw, pitch = math.radians(view.yaw), math.radians(view.pitch)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = _about_y(yaw) @ _about_x(-pitch)
    world_to_camera = before @ torch.linalg.inv(to_middle) @ turn.T @ to_middle
    return replace(camera, world_to_camera=world_to_camera.float())


def held_poses(performance: Performance, expressions: Sequence[str]) -> tuple[FrameParameters, ...]:
    """What moves the head in each of `POSES`, within what frames to train on have shown."""
    blinks = [index for index, name in enumerate(expressions) if name.startswith(BLINK)]
    closed = performance.expression[:, blinks].amax(dim=1) if blinks else torch.zeros(len(performance))
    opening = performance.jaw[:, 0] / JAW - closed
    widest = performance.train + int(opening[performance.train :].argmax())
    rest, frame = performance.frame(0), performance.frame(widest)
    # root and neck as at rest: yaw is then that of the face
    rotations = torch.cat([rest.rotations[:2], frame.rotations[2:]])
    return rest, FrameParameters(rest.translation, rotations, frame.expression)


def _about_y(angle: float) -> torch.Tensor:
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.tensor([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]], dtype=torch.float64)


def _about_x(angle: float) -> torch.Tensor:
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]], dtype=torch.float64)
