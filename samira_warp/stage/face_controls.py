"""What moves a face by hand: sliders of its joints and of its expressions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch

from samira_warp.avatar import DrivingFrame
from samira_warp.head import HeadTemplate

AT_HAND = 20
"""Expressions that are offered first."""


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
