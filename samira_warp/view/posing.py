"""From what a user moves to the parameters of a head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.avatar import DrivingFrame
from samira_warp.head import FrameParameters, HeadTemplate
from samira_warp.view.state import Pose

KEPT_AT_REST = ("root", "neck", "head")
"""Joints that keep the frame's rotation where the face is at rest: they place the head."""


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
