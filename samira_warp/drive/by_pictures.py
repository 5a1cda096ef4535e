"""From a head that was tracked in pictures to what an avatar takes over."""

from __future__ import annotations

import sys

import torch
from torch import Tensor

from samira_warp.avatar import match_expressions, match_joints
from samira_warp.drive.stance import Face, carrying_joints, joint_places
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate


class TrackedDriver:
    """Takes heads relative to a neutral one: expression, jaw and gaze less its own, and the head's motion."""

    def __init__(self, tracked: HeadTemplate, avatar: HeadTemplate, *, gain: float = 1.0) -> None:
        """Match two heads.

        Args:
            tracked: The head that is fitted to the pictures.
            avatar: The avatar's own.
            gain: Factor on the expression.

        Raises:
            UserError: They share too few of their expressions.
        """
        self._expressions = match_expressions(tracked, avatar, source="--drive")
        self._joints = match_joints(tracked, avatar)
        for kind, left_out in (
            ("expressions", self._expressions.left_out),
            ("joints", self._joints.left_out),
        ):
            if left_out:
                print(f"note: the avatar has no {kind} {', '.join(left_out)}", file=sys.stderr)
        self._tracked, self._gain = tracked, gain
        self._named = avatar.names_expressions
        self._carrying = carrying_joints(avatar)
        self._neutral: FrameParameters | None = None
        self._arm = torch.zeros(3, dtype=torch.float64)

    def take_for_neutral(self, neutral: FrameParameters, shape: Tensor) -> None:
        """Take a head for the neutral one from now on.

        Args:
            neutral: Its parameters.
            shape: (S,) its identity.
        """
        self._neutral = neutral.to(dtype=torch.float64)
        places = joint_places(self._tracked, shape)
        self._arm = places[self._tracked.joint_names.index(self._tracked.head_joint)] - places[0]

    @property
    def ready(self) -> bool:
        """Whether a neutral head is known."""
        return self._neutral is not None

    def face(self, parameters: FrameParameters) -> Face:
        """What is taken over of a frame."""
        neutral = self._neutral
        assert neutral is not None
        parameters = parameters.to(dtype=torch.float64)
        before, now = axis_angle_to_matrix(torch.stack([neutral.rotation, parameters.rotation]))
        moved = parameters.translation - neutral.translation + (now - before) @ self._arm
        expression = self._gain * self._expressions.carry(parameters.expression - neutral.expression)
        rotations = self._joints.carry(parameters.rotations - neutral.rotations, dim=-2)
        rotations[self._carrying] = 0.0
        if self._named:
            expression = expression.clamp(0.0, 1.0)
        return Face(before.mT @ now, before.mT @ moved, rotations, expression)


def middle_of(frames: list[FrameParameters]) -> FrameParameters:
    """The median of some frames, each number on its own; the frames are near each other."""

    def median(name: str) -> Tensor:
        return torch.stack([getattr(frame, name) for frame in frames]).median(dim=0).values

    return FrameParameters(median("translation"), median("rotations"), median("expression"))
