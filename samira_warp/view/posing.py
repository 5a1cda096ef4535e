"""From what a user moves to the parameters of a head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.avatar import DrivingFrame
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.view.state import Pose

AT_HAND = 20
"""Expressions that are offered first."""

KEPT_AT_REST = ("root", "neck", "head")
"""Joints that keep the frame's rotation where the face is at rest: they place the head."""


class JointControl(NamedTuple):
    """One slider of a rotation.

    Attributes:
        label: What it is called.
        joints: Joints that it turns, all alike.
        axis: Of the rotation: 0 nods down, 1 turns to the head's left, 2 tilts to its right.
        limit: Degrees either way.
    """

    label: str
    joints: tuple[str, ...]
    axis: int
    limit: float


_CONTROLS = (
    JointControl("jaw, open", ("jaw",), 0, 25.0),
    JointControl("jaw, aside", ("jaw",), 1, 10.0),
    JointControl("gaze, down", ("left_eye", "right_eye"), 0, 25.0),
    JointControl("gaze, left", ("left_eye", "right_eye"), 1, 35.0),
    JointControl("neck, nod", ("neck",), 0, 30.0),
    JointControl("neck, turn", ("neck",), 1, 45.0),
    JointControl("neck, tilt", ("neck",), 2, 30.0),
    JointControl("head, nod", ("head",), 0, 30.0),
    JointControl("head, turn", ("head",), 1, 60.0),
    JointControl("head, tilt", ("head",), 2, 30.0),
)


def joint_controls(template: HeadTemplate) -> list[JointControl]:
    """The sliders of the joints that a head has.

    The head turns by its joint of that name; where there is none, by the root, which carries it all.
    """
    names = template.joint_names
    turning = "head" if "head" in names else names[0]
    meant = [
        control._replace(joints=tuple(turning if joint == "head" else joint for joint in control.joints))
        for control in _CONTROLS
    ]
    return [control for control in meant if all(joint in names for joint in control.joints)]


class ExpressionControl(NamedTuple):
    """One slider of an expression.

    Attributes:
        name: The coefficient's.
        limit: What may be added or taken away.
    """

    name: str
    limit: float


def expression_controls(
    frames: Sequence[DrivingFrame], template: HeadTemplate
) -> tuple[list[ExpressionControl], list[ExpressionControl]]:
    """Sliders of all expressions, those that vary most over the training frames first, and the rest."""
    seen = [frame for frame in frames if frame.part == "train"] or list(frames)
    values = torch.stack([frame.parameters.expression for frame in seen]).double()
    variation = values.std(dim=0, correction=0)
    order = variation.argsort(descending=True, stable=True).tolist()
    limits = values.abs().amax(dim=0).clamp(min=1.0).tolist()
    controls = [
        ExpressionControl(template.expression_names[index], round(limits[index], 2)) for index in order
    ]
    return controls[:AT_HAND], controls[AT_HAND:]


class Poser:
    """The frames of a sequence in the order of their names, and what can be added to them.

    Attributes:
        frames: The frames.
        numbers: By frame, its number among those of its part, as ``render --frames`` counts them.
        template: The head.
    """

    def __init__(self, frames: Sequence[DrivingFrame], template: HeadTemplate) -> None:
        order = sorted(range(len(frames)), key=lambda index: frames[index].name)
        parts = [frame.part for frame in frames]
        self.frames = [frames[index] for index in order]
        self.numbers = [parts[:index].count(parts[index]) for index in order]
        self.template = template
        self._expressions = {name: index for index, name in enumerate(template.expression_names)}
        self._joints = {name: index for index, name in enumerate(template.joint_names)}

    def parameters(self, pose: Pose) -> FrameParameters:
        """The head's parameters, those of the frame itself where nothing is added."""
        frame = self.frames[min(pose.frame, len(self.frames) - 1)]
        parameters = frame.parameters if pose.live is None else pose.live
        if pose.neutral:
            parameters = self._at_rest(parameters)
        if pose.expression:
            expression = parameters.expression.clone()
            for name, value in pose.expression:
                expression[self._expressions[name]] += value
            parameters = replace(parameters, expression=expression)
        if pose.joints:
            rotations = parameters.rotations.clone()
            for name, degrees in pose.joints:
                joint = self._joints[name]
                rotations[joint] = _turned(rotations[joint], degrees)
            parameters = replace(parameters, rotations=rotations)
        return parameters

    def _at_rest(self, parameters: FrameParameters) -> FrameParameters:
        """The frame's place and turn of the head, and a face at rest."""
        rotations = torch.zeros_like(parameters.rotations)
        for joint, name in enumerate(self.template.joint_names):
            if joint == 0 or name in KEPT_AT_REST:
                rotations[joint] = parameters.rotations[joint]
        expression = torch.zeros_like(parameters.expression)
        return replace(parameters, rotations=rotations, expression=expression, dynamic_offset=None)


def _turned(rotation: Tensor, degrees: Sequence[float]) -> Tensor:
    """(3,) axis-angle radians: a rotation after one of so many degrees about the joint's own axes."""
    own = Rotation.from_rotvec(rotation.double().numpy())
    added = Rotation.from_rotvec(list(degrees), degrees=True)
    return torch.from_numpy((own * added).as_rotvec()).to(rotation)
