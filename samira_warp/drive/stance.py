"""How an avatar's head stands at rest, and how it moves from there as somebody else's does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.avatar import DrivingFrame, PoseRange
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate

CARRYING = ("root", "neck", "head")
"""Joints that place the head; the first joint of a template is the root, whatever it is called."""


class Face(NamedTuple):
    """What is taken over from somebody, relative to their neutral face.

    Attributes:
        turn: (3, 3) rotation of the head, in the axes that it has at rest.
        shift: (3,) metres by which the place of the joint that carries the head has moved, in the same axes.
        rotations: (J, 3) axis-angle radians of the avatar's joints within the face; those that carry it are
            0.
        expression: (E,) the avatar's coefficients.
    """

    turn: Tensor
    shift: Tensor
    rotations: Tensor
    expression: Tensor


@dataclass(frozen=True, eq=False)
class Stance:
    """An avatar's head as it is when its driver's is neutral.

    Its pose is that of the training frame in which it looks most nearly into the camera. The head turns by
    the one of the joints that carry it which turned it most in training: what another one does to the picture
    was never seen.

    Attributes:
        template: The head.
        frame: The training frame; its camera is the one that the avatar is seen by.
        rest: Its parameters, the face at rest.
        turning: Index of the joint that turns the head.
        places: (J, 3) where the joints are on the head at rest.
        seen: What poses training showed.
    """

    template: HeadTemplate
    frame: DrivingFrame
    rest: FrameParameters
    turning: int
    places: Tensor
    seen: PoseRange

    @classmethod
    def of(cls, template: HeadTemplate, frames: Sequence[DrivingFrame], shape: Tensor) -> Stance:
        """The stance of an avatar.

        Args:
            template: Its head.
            frames: Those that it was made from, at least one.
            shape: (S,) its identity.
        """
        frames = [frame for frame in frames if frame.part == "train"] or list(frames)
        carrying = carrying_joints(template)
        frame = min(frames, key=lambda one: _off_camera(one, carrying))
        seen = PoseRange.of(frame.parameters for frame in frames)
        span = (seen.high - seen.low).norm(dim=-1)
        return cls(
            template,
            frame,
            _at_rest(frame.parameters, carrying),
            max(carrying, key=lambda joint: float(span[joint])),
            joint_places(template, shape),
            seen,
        )

    def pose(self, face: Face, *, clamp: bool = True) -> FrameParameters:
        """The avatar's parameters, float32.

        Args:
            face: What is taken over.
            clamp: Hold the pose to what was seen in training.
        """
        rest, turning = self.rest, self.turning
        turns = axis_angle_to_matrix(rest.rotations.double())
        carrying = carrying_joints(self.template)
        after = _product(turns, [joint for joint in carrying if joint > turning])
        until = _product(turns, [joint for joint in carrying if joint <= turning])
        turn = after @ face.turn @ after.mT
        rotations = face.rotations.double() + rest.rotations.double()
        rotations[turning] = rotation_vector(turns[turning] @ turn)
        held = self.seen.hold(FrameParameters(rest.translation, rotations.float(), face.expression.float()))
        if clamp:
            rotations = held.rotations.double()
        # where another joint turns than the one that carries the head, the turn moves that one, too
        done = turns[turning].mT @ axis_angle_to_matrix(rotations[turning][None])[0]
        head = self.template.joint_names.index(self.template.head_joint)
        arm = self.places[max(head, turning)] - self.places[turning]
        shift = until @ after @ face.shift - until @ (done @ arm - arm)
        return FrameParameters(
            (rest.translation.double() + shift).float(), rotations.float(), face.expression.float()
        )


def carrying_joints(template: HeadTemplate) -> list[int]:
    """The joints that place the head, in the order of the template: parents before children."""
    names = template.joint_names
    return [joint for joint, name in enumerate(names) if joint == 0 or name in CARRYING]


def joint_places(template: HeadTemplate, shape: Tensor) -> Tensor:
    """(J, 3) float64 where the joints are on a head of an identity at rest."""
    shape = shape.detach().cpu().double()
    vertices = torch.from_numpy(template.v_template).double()
    vertices = vertices + torch.from_numpy(template.shapedirs[..., : template.n_shape]).double() @ shape
    return torch.from_numpy(template.joint_regressor).double() @ vertices


def rotation_vector(turn: Tensor) -> Tensor:
    """(3,) axis-angle radians of a (3, 3) rotation."""
    return torch.from_numpy(Rotation.from_matrix(turn.numpy()).as_rotvec())


def _product(turns: Tensor, joints: Sequence[int]) -> Tensor:
    """(3, 3) product of some joints' turns, from the first on."""
    product = torch.eye(3, dtype=turns.dtype)
    for joint in joints:
        product = product @ turns[joint]
    return product


def _off_camera(frame: DrivingFrame, carrying: Sequence[int]) -> float:
    """Radians between how a frame's head is turned and one that looks into the camera, upright."""
    head = _product(axis_angle_to_matrix(frame.parameters.rotations.double()), carrying)
    seen = frame.camera.world_to_camera[:3, :3].double().cpu() @ head
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    return float(rotation_vector(facing.mT @ seen).norm())


def _at_rest(parameters: FrameParameters, carrying: Sequence[int]) -> FrameParameters:
    """A frame's place and turn of the head, and a face at rest."""
    rotations = torch.zeros_like(parameters.rotations)
    rotations[list(carrying)] = parameters.rotations[list(carrying)]
    return FrameParameters(parameters.translation, rotations, torch.zeros_like(parameters.expression))
