"""The parametric head in motion: linear shapes and linear blend skinning over five joints."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head.template import HeadTemplate
from samira_warp.support.validation import check_tensor

NECK = 1
"""The joint whose transform carries the head (FLAME's order: root, neck, jaw, eyes)."""


@dataclass(frozen=True, eq=False)
class FrameParameters:
    """What moves the head in one frame: axis-angle rotations in radians, lengths in metres.

    Attributes:
        translation: (3,) of the whole head, after all rotations.
        rotation: (3,) of the root joint about its own location.
        neck: (3,) of the neck joint.
        jaw: (3,) of the jaw joint.
        eyes: (6,) of the two eye joints, in the template's order.
        expression: (E,) coefficients of the expression shapes.
        static_offset: (V, 3) the subject's own offset from the linear shapes, or None for zero.
        dynamic_offset: (V, 3) this frame's offset, or None for zero.
    """

    translation: torch.Tensor
    rotation: torch.Tensor
    neck: torch.Tensor
    jaw: torch.Tensor
    eyes: torch.Tensor
    expression: torch.Tensor
    static_offset: torch.Tensor | None = None
    dynamic_offset: torch.Tensor | None = None

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> FrameParameters:
        """The same parameters on another device, in another precision, or both."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return FrameParameters(
            **{
                name: None if value is None else value.to(device=device, dtype=dtype)
                for name, value in values.items()
            }
        )


class PosedHead(NamedTuple):
    """A head in the world.

    Attributes:
        vertices: (V, 3) metres.
        joint_transforms: (5, 4, 4) rigid; entry j takes a point that is fixed to joint j from where it is at
            rest (zero pose and translation) to where it is in the world.
    """

    vertices: torch.Tensor
    joint_transforms: torch.Tensor

    def in_head_frame(self) -> torch.Tensor:
        """(V, 3) vertices with the neck joint's motion undone: what is left of the rest mesh's motion is
        face, jaw and eyes.
        """
        transform = self.joint_transforms[NECK]
        return (self.vertices - transform[:3, 3]) @ transform[:3, :3]


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A template's tensors on one device, in one precision.

    Attributes:
        v_template: (V, 3) mean head, metres.
        shapedirs: (V, 3, S + E) linear shapes: identity first, then expression.
        n_shape: S.
        posedirs: (V, 3, 36) pose correctives.
        joint_regressor: (5, V).
        weights: (V, 5) skinning weights.
        parents: Parent of each joint, -1 for the root.
    """

    v_template: torch.Tensor
    shapedirs: torch.Tensor
    n_shape: int
    posedirs: torch.Tensor
    joint_regressor: torch.Tensor
    weights: torch.Tensor
    parents: tuple[int, ...]

    @classmethod
    def build(cls, template: HeadTemplate) -> HeadModel:
        """A float32 model on the CPU."""

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(array.copy())

        return cls(
            v_template=tensor(template.v_template),
            shapedirs=tensor(template.shapedirs),
            n_shape=template.n_shape,
            posedirs=tensor(template.posedirs),
            joint_regressor=tensor(template.joint_regressor),
            weights=tensor(template.weights),
            parents=tuple(template.parents.tolist()),
        )

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> HeadModel:
        """The same model on another device, in another precision, or both."""
        tensors = {
            name: value.to(device=device, dtype=dtype)
            for name, value in vars(self).items()
            if isinstance(value, torch.Tensor)
        }
        return replace(self, **tensors)

    @property
    def n_expression(self) -> int:
        """E, how many expression coefficients the model takes."""
        return self.shapedirs.shape[2] - self.n_shape

    def rest(self) -> FrameParameters:
        """Parameters of zero pose, translation and expression."""

        def zeros(count: int) -> torch.Tensor:
            return self.v_template.new_zeros(count)

        return FrameParameters(zeros(3), zeros(3), zeros(3), zeros(3), zeros(6), zeros(self.n_expression))

    def vertices(self, parameters: FrameParameters, shape: torch.Tensor) -> PosedHead:
        """Pose the head, differentiably in the parameters and the shape.

        Joints are regressed from template + identity + expression + offsets, before the pose correctives, as
        VHAP and GaussianAvatars call FLAME; the global rotation turns the head about the root joint, and the
        translation comes last.

        Args:
            parameters: One frame, with the model's device and dtype.
            shape: (S,) identity coefficients.

        Raises:
            UserError: A parameter has another shape, dtype or device than the model needs.
        """
        self._check(parameters, shape)
        unposed = self.v_template + self.shapedirs @ torch.cat([shape, parameters.expression])
        for offset in (parameters.static_offset, parameters.dynamic_offset):
            if offset is not None:
                unposed = unposed + offset
        joints = self.joint_regressor @ unposed

        axis_angles = torch.cat([parameters.rotation, parameters.neck, parameters.jaw, parameters.eyes])
        rotations = axis_angle_to_matrix(axis_angles.view(-1, 3))
        identity = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
        corrected = unposed + self.posedirs @ (rotations[1:] - identity).flatten()

        skinning = self._chain(rotations, joints)
        blended = (self.weights @ skinning.flatten(1)).view(-1, 3, 4)
        posed = (
            (blended[:, :, :3] @ corrected[..., None]).squeeze(-1) + blended[:, :, 3] + parameters.translation
        )
        return PosedHead(posed, _to_homogeneous(skinning, parameters.translation))

    def _chain(self, rotations: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
        """(5, 3, 4) each joint's transform of the rest pose: its own turn about its location, then its
        ancestors'.
        """
        turns: list[torch.Tensor] = []
        shifts: list[torch.Tensor] = []
        for joint, parent in enumerate(self.parents):
            turn, shift = rotations[joint], joints[joint] - rotations[joint] @ joints[joint]
            if parent >= 0:
                turn, shift = turns[parent] @ turn, turns[parent] @ shift + shifts[parent]
            turns.append(turn)
            shifts.append(shift)
        return torch.cat([torch.stack(turns), torch.stack(shifts)[..., None]], dim=-1)

    def _check(self, parameters: FrameParameters, shape: torch.Tensor) -> None:
        of_model = {"dtype": self.v_template.dtype, "device": self.v_template.device}
        sizes = {
            "translation": 3,
            "rotation": 3,
            "neck": 3,
            "jaw": 3,
            "eyes": 6,
            "expression": self.n_expression,
        }
        for name, size in sizes.items():
            check_tensor(name, getattr(parameters, name), shape=(size,), **of_model)
        for name in ("static_offset", "dynamic_offset"):
            if getattr(parameters, name) is not None:
                check_tensor(name, getattr(parameters, name), shape=self.v_template.shape, **of_model)
        check_tensor("shape", shape, shape=(self.n_shape,), **of_model)


def _to_homogeneous(skinning: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    top = torch.cat([skinning[..., :3], (skinning[..., 3] + translation)[..., None]], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(top), 1, 4)
    return torch.cat([top, bottom], dim=1)
