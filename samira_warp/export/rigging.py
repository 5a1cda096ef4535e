"""A rig as other programs know one: joints with places and turns relative to their parents.

There a joint stays where it is at rest. Here joints are regressed from vertices, and expressions move them;
so a frame's translation of a joint has both, its place and what its own turn about a moved centre leaves:
with J the place at rest and J' that of the frame, t = J' + R (J - J') - J of the parent.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head import FrameParameters, HeadTemplate


class RestJoints(NamedTuple):
    """Where J joints are at rest, and how E expressions move them.

    Attributes:
        places: (J, 3) metres, in the axes of the head at rest.
        shifts: (E, J, 3) metres by each expression's coefficient.
    """

    places: Tensor
    shifts: Tensor

    @classmethod
    def of(cls, canonical: CanonicalHead) -> RestJoints:
        """The joints of a subject."""
        rig = canonical.rig
        shapes = rig.shapedirs[:, :, rig.n_shape :]
        return cls(
            rig.joint_regressor @ canonical.vertices,
            torch.einsum("jv,vce->ejc", rig.joint_regressor, shapes),
        )


class JointTracks(NamedTuple):
    """Every joint relative to its parent, in B frames.

    Attributes:
        rotations: (B, J, 4) unit quaternions x, y, z, w, neighbours in time on the same side.
        translations: (B, J, 3) metres.
    """

    rotations: Tensor
    translations: Tensor


def joint_tracks(canonical: CanonicalHead, parameters: FrameParameters) -> JointTracks:
    """The joints' own motion in a batch of frames, in float64."""
    joints, parents = RestJoints.of(canonical), canonical.rig.parents
    rest = joints.places.double()
    places = rest + torch.einsum("be,ejc->bjc", parameters.expression.double(), joints.shifts.double())
    turns = axis_angle_to_matrix(parameters.rotations.double().flatten(0, 1)).unflatten(0, places.shape[:2])
    own = places + (turns @ (rest - places)[..., None])[..., 0]
    below = torch.stack([rest.new_zeros(3) if parent < 0 else rest[parent] for parent in parents])
    translations = own - below
    translations[:, 0] += parameters.translation.double()
    return JointTracks(_continuous(_quaternions(parameters.rotations.double())), translations)


def pose_weights(parameters: FrameParameters) -> Tensor:
    """(B, 9 (J - 1)) weights of the pose correctives: rotations of all joints but the root, less identity."""
    turns = axis_angle_to_matrix(parameters.rotations.double().flatten(0, 1))
    turns = turns.unflatten(0, parameters.rotations.shape[:2]) - torch.eye(3, dtype=torch.float64)
    return turns[:, 1:].flatten(1)


def has_correctives(template: HeadTemplate) -> bool:
    """Whether turned joints change the head's shape beyond skinning."""
    return bool(np.any(template.posedirs))


def tell_offsets(parameters: FrameParameters) -> None:
    """Say so where frames have offsets of their own, which no expression makes."""
    if parameters.dynamic_offset is not None:
        mean = 1000.0 * float(parameters.dynamic_offset.norm(dim=-1).mean())
        print(f"note: the frames' own offsets, {mean:.1f} mm on average, are left out", file=sys.stderr)


def _quaternions(axis_angle: Tensor) -> Tensor:
    """(..., 4) unit x, y, z, w of (..., 3) radians."""
    half = 0.5 * axis_angle.norm(dim=-1, keepdim=True)
    # sin(x) / x, which torch has as sinc(x / pi), is 1 at 0
    return torch.cat([0.5 * torch.sinc(half / torch.pi) * axis_angle, torch.cos(half)], dim=-1)


def _continuous(quaternions: Tensor) -> Tensor:
    """The same turns, each on the side of the one before: what is between two frames is the short way."""
    turned = (quaternions[1:] * quaternions[:-1]).sum(dim=-1, keepdim=True) < 0.0
    sides = torch.where(turned, -1.0, 1.0).cumprod(dim=0)
    return torch.cat([quaternions[:1], sides * quaternions[1:]])
