"""The parametric head in motion: linear shapes and linear blend skinning over a tree of named joints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor


class PosedHead(NamedTuple):
    """Heads in the world, with the leading dimensions of the parameters that posed them.

    Attributes:
        vertices: (..., V, 3) metres.
        joint_transforms: (..., J, 4, 4) rigid; entry j takes a point that is fixed to joint j from where it
            is at rest (zero pose and translation) to where it is in the world.
        head_joint: Index of the joint that carries the head.
    """

    vertices: Tensor
    joint_transforms: Tensor
    head_joint: int

    @property
    def head_transform(self) -> Tensor:
        """(..., 4, 4) rigid motion of the head from the reference mesh to the world."""
        return self.joint_transforms[..., self.head_joint, :, :]

    def in_head_frame(self) -> Tensor:
        """(..., V, 3) vertices with the head joint's motion undone.

        What is left of the rest mesh's motion is face, jaw and eyes.
        """
        transform = self.head_transform
        return (self.vertices - transform[..., None, :3, 3]) @ transform[..., :3, :3]


@dataclass(frozen=True, eq=False)
class Rig:
    """A template's tensors on one device, in one precision.

    Attributes:
        v_template: (V, 3) mean head, metres.
        shapedirs: (V, 3, S + E) linear shapes: identity first, then expression.
        n_shape: S.
        posedirs: (V, 3, 9 (J - 1)) pose correctives.
        joint_regressor: (J, V).
        weights: (V, J) skinning weights.
        parents: Parent of each joint, which precedes it, -1 for the root.
        joint_names: J names.
        head_joint: Name of the joint that carries the head.
    """

    v_template: Tensor
    shapedirs: Tensor
    n_shape: int
    posedirs: Tensor
    joint_regressor: Tensor
    weights: Tensor
    parents: tuple[int, ...]
    joint_names: tuple[str, ...]
    head_joint: str

    @classmethod
    def build(cls, template: HeadTemplate) -> Rig:
        """A float32 rig on the CPU."""

        def tensor(array: np.ndarray) -> Tensor:
            # torch's own memory is aligned, numpy's as it happens to come: sums of products end in other bits
            return torch.tensor(array)

        return cls(
            v_template=tensor(template.v_template),
            shapedirs=tensor(template.shapedirs),
            n_shape=template.n_shape,
            posedirs=tensor(template.posedirs),
            joint_regressor=tensor(template.joint_regressor),
            weights=tensor(template.weights),
            parents=tuple(template.parents.tolist()),
            joint_names=template.joint_names,
            head_joint=template.head_joint,
        )

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Rig:
        """The same rig on another device, in another precision, or both."""
        moved: dict[str, Any] = {
            name: value.to(device=device, dtype=dtype)
            for name, value in vars(self).items()
            if isinstance(value, Tensor)
        }
        return replace(self, **moved)

    @property
    def n_expression(self) -> int:
        """E, how many expression coefficients the rig takes."""
        return self.shapedirs.shape[2] - self.n_shape

    @property
    def pose_size(self) -> int:
        """3 J, how many numbers a pose has."""
        return 3 * len(self.joint_names)

    def joint(self, name: str) -> int:
        """Index of a joint.

        Raises:
            UserError: There is none of that name.
        """
        if name not in self.joint_names:
            raise UserError("joint", expected=f"one of {', '.join(self.joint_names)}", found=repr(name))
        return self.joint_names.index(name)

    def rest(self) -> FrameParameters:
        """One frame's parameters of zero pose, translation and expression."""
        zeros = self.v_template.new_zeros
        return FrameParameters(zeros(3), zeros(len(self.joint_names), 3), zeros(self.n_expression))

    def pose(
        self, parameters: FrameParameters, shape: Tensor, static_offset: Tensor | None = None
    ) -> PosedHead:
        """Pose the head in one frame or in many, differentiably in all arguments.

        Joints are regressed from template + identity + expression + offsets, before the pose correctives, as
        VHAP and GaussianAvatars call FLAME; each joint turns about its own location and takes its children
        along, and the translation comes last. A batch is the frames one by one up to rounding: its products
        sum in another order.

        Args:
            parameters: Frames with the rig's device and dtype.
            shape: (S,) identity coefficients.
            static_offset: (V, 3) the subject's own offset from the linear shapes, or None for zero.

        Raises:
            UserError: An argument has another shape, dtype or device than the rig needs.
        """
        self._check(parameters, shape, static_offset)
        identity = shape.expand(*parameters.batch_shape, -1)
        unposed = self.v_template + _combine(
            self.shapedirs, torch.cat([identity, parameters.expression], dim=-1)
        )
        for offset in (static_offset, parameters.dynamic_offset):
            if offset is not None:
                unposed = unposed + offset
        joints = self.joint_regressor @ unposed

        # one list of joints, a node of its own: the bits of its gradient do not hang on who else has a share
        turns = axis_angle_to_matrix(parameters.rotations.reshape(-1, 3))
        rotations = turns.view(*parameters.rotations.shape, 3)
        unturned = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
        corrected = unposed + _combine(self.posedirs, (rotations[..., 1:, :, :] - unturned).flatten(-3))

        skinning = self._chain(rotations, joints)
        blended = (self.weights @ skinning.flatten(-2)).unflatten(-1, (3, 4))
        turned = (blended[..., :3] @ corrected[..., None]).squeeze(-1)
        posed = turned + blended[..., 3] + parameters.translation[..., None, :]
        transforms = _to_homogeneous(skinning, parameters.translation)
        return PosedHead(posed, transforms, self.joint(self.head_joint))

    def _chain(self, rotations: Tensor, joints: Tensor) -> Tensor:
        """(..., J, 3, 4) each joint's transform of the rest pose.

        It is the joint's own turn about its location, then its ancestors'.
        """
        turns: list[Tensor] = []
        shifts: list[Tensor] = []
        for joint, parent in enumerate(self.parents):
            turn, location = rotations[..., joint, :, :], joints[..., joint, :, None]
            shift = location - turn @ location
            if parent >= 0:
                turn, shift = turns[parent] @ turn, turns[parent] @ shift + shifts[parent]
            turns.append(turn)
            shifts.append(shift)
        return torch.cat([torch.stack(turns, dim=-3), torch.stack(shifts, dim=-3)], dim=-1)

    def _check(self, parameters: FrameParameters, shape: Tensor, static_offset: Tensor | None) -> None:
        vertices, batch = self.v_template.shape, parameters.batch_shape
        wanted = {
            "translation": (parameters.translation, (*batch, 3)),
            "rotations": (parameters.rotations, (*batch, len(self.joint_names), 3)),
            "expression": (parameters.expression, (*batch, self.n_expression)),
            "dynamic_offset": (parameters.dynamic_offset, (*batch, *vertices)),
            "static_offset": (static_offset, vertices),
            "shape": (shape, (self.n_shape,)),
        }
        for name, (tensor, size) in wanted.items():
            if tensor is not None:
                check_tensor(
                    name, tensor, shape=size, dtype=self.v_template.dtype, device=self.v_template.device
                )


class HeadModel(Rig):
    """`Rig` by the name that it had in 0.1, until 0.3."""

    def vertices(self, parameters: FrameParameters, shape: Tensor) -> PosedHead:
        """`Rig.pose`, of a subject without a static offset."""
        warnings.warn(
            "HeadModel.vertices is Rig.pose now: it ends with 0.3", DeprecationWarning, stacklevel=2
        )
        return self.pose(parameters, shape)


def _combine(directions: Tensor, coefficients: Tensor) -> Tensor:
    """(..., V, 3) sums of (V, 3, K) directions by (..., K) coefficients."""
    flat = torch.nn.functional.linear(coefficients, directions.flatten(0, 1))
    return flat.unflatten(-1, directions.shape[:2])


def _to_homogeneous(skinning: Tensor, translation: Tensor) -> Tensor:
    """(..., J, 4, 4) of (..., J, 3, 4) transforms, moved by (..., 3)."""
    moved = skinning[..., 3] + translation[..., None, :]
    top = torch.cat([skinning[..., :3], moved[..., None]], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)
