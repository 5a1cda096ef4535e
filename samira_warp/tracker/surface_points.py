"""Points fixed to a rig's surface, and how they move with every parameter.

Linear blend skinning moves a point between three vertices by a sum over joints of each joint's transform, of
something linear in the coefficients. So a point's place is exact without posing the mesh, and so are its
derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.geometry.rotation import axis_angle_to_matrix, left_jacobian
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.rig import Rig


class _Carried(NamedTuple):
    """What one joint carries: M of the points, or shares of them.

    Attributes:
        points: (M,) int64 which points.
        share: (M,) how much of each.
        rest: (M, 3) that much of the point on the mean head.
        identity: (M, 3, S) of each identity shape.
        expression: (M, 3, E) of each expression shape.
        correctives: (M, 3, 9 (J - 1)) of each pose corrective, None where the rig has none.
        offset: (M, K) of each basis function.
    """

    points: Tensor
    share: Tensor
    rest: Tensor
    identity: Tensor
    expression: Tensor
    correctives: Tensor | None
    offset: Tensor


class _Joints(NamedTuple):
    """Where the joints are: of the mean head (J, 3), and by each coefficient."""

    rest: Tensor
    identity: Tensor
    expression: Tensor
    offset: Tensor


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """L points of a rig's surface, with K basis functions of the subject's offset.

    Attributes:
        count: L.
        carried: What each joint carries.
        joints: Where the joints are.
        parents: Parent of each joint, -1 for the root.
        moving: Joints that turn, at least one.
    """

    count: int
    carried: tuple[_Carried, ...]
    joints: _Joints
    parents: tuple[int, ...]
    moving: tuple[int, ...]

    @classmethod
    def build(
        cls, rig: Rig, corners: Tensor, barycentrics: Tensor, *, basis: Tensor, moving: Sequence[int]
    ) -> SurfacePoints:
        """Gather what moves the points.

        Args:
            rig: The head.
            corners: (L, 3) vertex ids of the points' triangles.
            barycentrics: (L, 3) weights of the corners.
            basis: (V, K) basis functions of the offset; K may be 0.
            moving: Joints that turn, at least one, parents before children.
        """
        corners = corners.long()
        shares = barycentrics[:, :, None] * rig.weights[corners]
        carried = tuple(
            _carried(rig, corners, shares[..., joint], basis) for joint in range(len(rig.joint_names))
        )
        shapes = torch.einsum("jv,vdk->jdk", rig.joint_regressor, rig.shapedirs)
        joints = _Joints(
            rest=rig.joint_regressor @ rig.v_template,
            identity=shapes[..., : rig.n_shape],
            expression=shapes[..., rig.n_shape :],
            offset=rig.joint_regressor @ basis,
        )
        return cls(len(corners), carried, joints, rig.parents, tuple(moving))

    def pose(self, parameters: FrameParameters, shape: Tensor, offset: Tensor) -> PosedPoints:
        """The points in N frames.

        Args:
            parameters: N frames.
            shape: (S,) identity.
            offset: (K, 3) coefficients of the basis functions, metres.
        """
        expression, joints = parameters.expression, self.joints
        places = (
            joints.rest
            + joints.identity @ shape
            + joints.offset @ offset
            + torch.einsum("jde,ne->njd", joints.expression, expression)
        )
        rotations = axis_angle_to_matrix(parameters.rotations.reshape(-1, 3))
        rotations = rotations.view(*parameters.rotations.shape, 3)
        chain = _chain(self.parents, rotations, places)
        turned, points = [], parameters.translation[:, None, :].repeat(1, self.count, 1)
        for joint, carried in enumerate(self.carried):
            unposed = carried.rest + carried.identity @ shape + carried.offset @ offset
            unposed = unposed + _combined(carried.expression, expression)
            if carried.correctives is not None:
                unturned = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
                feature = (rotations[:, 1:] - unturned).flatten(1)
                unposed = unposed + _combined(carried.correctives, feature)
            moved = unposed @ chain.turns[:, joint].mT
            moved = moved + carried.share[:, None] * chain.shifts[:, joint, None, :]
            points.index_add_(1, carried.points, moved)
            turned.append(moved)
        return PosedPoints(self, parameters.rotations, chain, tuple(turned), points)

    def below(self, joint: int) -> list[int]:
        """A joint and all its descendants."""
        found = [joint]
        for other, parent in enumerate(self.parents):
            if parent in found and other not in found:
                found.append(other)
        return found


class _Chain(NamedTuple):
    """The joints' transforms of the rest pose, without the translation.

    Attributes:
        turns: (N, J, 3, 3).
        shifts: (N, J, 3).
        before: (N, J, 3, 3) turn of each joint's parent, the identity for the root.
        places: (N, J, 3) where each joint is.
    """

    turns: Tensor
    shifts: Tensor
    before: Tensor
    places: Tensor


@dataclass(frozen=True, eq=False)
class PosedPoints:
    """Surface points in N frames, and how linear functions of their places change.

    The functions are rows (N, L, R, 3) that a point's place is multiplied by: the projection's derivatives,
    or an image's slopes times these. Derivatives by turns leave the pose correctives out.

    Attributes:
        source: The points.
        rotations: (N, J, 3) axis-angles.
        chain: The joints' transforms.
        turned: (N, M, 3) for each joint, where it takes what it carries, without the translation.
        points: (N, L, 3) metres in the world.
    """

    source: SurfacePoints
    rotations: Tensor
    chain: _Chain
    turned: tuple[Tensor, ...]
    points: Tensor

    def by_frame(self, rows: Tensor) -> Tensor:
        """(N, L, R, P) by translation, axis-angles of the moving joints, and expression."""
        shapes = tuple(carried.expression for carried in self.source.carried)
        turns = [self._by_turn(joint, rows) for joint in self.source.moving]
        return torch.cat([rows, *turns, self._by_shapes(rows, shapes, self.source.joints.expression)], dim=-1)

    def by_subject(self, rows: Tensor) -> Tensor:
        """(N, L, R, Q) by identity, then the offset's coefficients: x, y, z of the first function first."""
        shapes = tuple(carried.identity for carried in self.source.carried)
        identity = self._by_shapes(rows, shapes, self.source.joints.identity)
        offset = rows.new_zeros(*rows.shape, self.source.joints.offset.shape[1])
        for joint, carried in enumerate(self.source.carried):
            turned = rows[:, carried.points] @ self.chain.turns[:, joint, None]
            offset.index_add_(1, carried.points, turned[..., None] * carried.offset[:, None, None, :])
            offset += self._shifted(rows, joint)[..., None] * self.source.joints.offset[joint]
        return torch.cat([identity, offset.mT.flatten(-2)], dim=-1)

    def _by_turn(self, joint: int, rows: Tensor) -> Tensor:
        """(N, L, R, 3): a joint turns all that it and its descendants carry about its own place."""
        arm = torch.zeros_like(self.points)
        for other in self.source.below(joint):
            carried = self.source.carried[other]
            place = self.chain.places[:, joint, None, :]
            arm.index_add_(1, carried.points, self.turned[other] - carried.share[:, None] * place)
        axes = self.chain.before[:, joint] @ left_jacobian(self.rotations[:, joint])
        # row . (axis x arm) = axis . (arm x row)
        moments = torch.linalg.cross(arm[:, :, None, :].expand_as(rows), rows, dim=-1)
        return moments @ axes[:, None]

    def _by_shapes(self, rows: Tensor, shapes: tuple[Tensor, ...], joints: Tensor) -> Tensor:
        """(N, L, R, C) by coefficients of (M, 3, C) shapes that move the joints by (J, 3, C)."""
        found = rows.new_zeros(*rows.shape[:-1], joints.shape[-1])
        for joint, carried in enumerate(self.source.carried):
            turned = rows[:, carried.points] @ self.chain.turns[:, joint, None]
            found.index_add_(1, carried.points, turned @ shapes[joint])
            if bool(joints[joint].any()):
                found += self._shifted(rows, joint) @ joints[joint]
        return found

    def _shifted(self, rows: Tensor, joint: int) -> Tensor:
        """(N, L, R, 3) rows by a joint's place on the unposed head.

        Its place p shifts what it and its descendants carry by (parent's turn - its own) p.
        """
        shares = rows.new_zeros(self.source.count)
        for other in self.source.below(joint):
            carried = self.source.carried[other]
            shares.index_add_(0, carried.points, carried.share)
        moves = self.chain.before[:, joint] - self.chain.turns[:, joint]
        return shares[:, None, None] * (rows @ moves[:, None])


def _carried(rig: Rig, corners: Tensor, shares: Tensor, basis: Tensor) -> _Carried:
    """What one joint carries of points with (L, 3) shares of their corners."""
    index = (shares.abs().sum(dim=1) > 0).nonzero()[:, 0]
    corners, shares = corners[index], shares[index]

    def of(values: Tensor) -> Tensor:
        return torch.einsum("mc,mc...->m...", shares, values[corners])

    shapes = of(rig.shapedirs)
    return _Carried(
        points=index,
        share=shares.sum(dim=1),
        rest=of(rig.v_template),
        identity=shapes[..., : rig.n_shape],
        expression=shapes[..., rig.n_shape :].contiguous(),
        correctives=of(rig.posedirs) if bool(rig.posedirs.any()) else None,
        offset=of(basis),
    )


def _combined(shapes: Tensor, coefficients: Tensor) -> Tensor:
    """(N, M, 3) sums of (M, 3, C) shapes by (N, C) coefficients."""
    return torch.nn.functional.linear(coefficients, shapes.flatten(0, 1)).unflatten(-1, shapes.shape[:2])


def _chain(parents: tuple[int, ...], rotations: Tensor, joints: Tensor) -> _Chain:
    """Each joint's turn about its own place, then its ancestors'."""
    turns: list[Tensor] = []
    shifts: list[Tensor] = []
    before: list[Tensor] = []
    places: list[Tensor] = []
    for joint, parent in enumerate(parents):
        turn, location = rotations[:, joint], joints[:, joint, :, None]
        shift = location - turn @ location
        if parent < 0:
            before.append(torch.eye(3, dtype=turn.dtype, device=turn.device).expand_as(turn))
            places.append(location[..., 0])
        else:
            before.append(turns[parent])
            places.append((turns[parent] @ location)[..., 0] + shifts[parent])
            turn, shift = turns[parent] @ turn, turns[parent] @ shift + shifts[parent][..., None]
        turns.append(turn)
        shifts.append(shift[..., 0])
    return _Chain(*(torch.stack(parts, dim=1) for parts in (turns, shifts, before, places)))
