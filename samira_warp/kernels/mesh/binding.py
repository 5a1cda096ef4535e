"""Gaussians bound to triangles: Eq. lbs and Eq. normal_transform."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.gathering.grouping import Groups, group_by
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_ids, check_tensors

GRAIN = 1024
"""Gaussians, or triangles, that are worth a thread."""


class BoundGaussians(NamedTuple):
    """Gaussians in world space.

    Attributes:
        means: (N, 3) centres, metres.
        quaternions: (N, 4) unit rotations (w, x, y, z).
        scales: (N, 3) standard deviations along the Gaussian's own axes, metres.
        normals: (N, 3) unit normals.
    """

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    normals: Tensor


@dataclass(frozen=True, eq=False)
class FaceBinding:
    """Which triangle each Gaussian follows, and the Gaussians of each triangle.

    Attributes:
        faces: (N,) int32 triangle of each Gaussian.
        face_count: F.
        gaussians: For each triangle its Gaussians.
    """

    faces: Tensor
    face_count: int
    gaussians: Groups

    def __post_init__(self) -> None:
        check_tensors(
            ("faces", self.faces, ("N",), torch.int32),
            ("gaussians.offsets", self.gaussians.offsets, (self.face_count + 1,), torch.int32),
            ("gaussians.members", self.gaussians.members, ("N",), torch.int32),
        )

    @classmethod
    def build(cls, faces: Tensor, face_count: int) -> FaceBinding:
        """List the Gaussians of every triangle.

        Args:
            faces: (N,) integers from 0 to ``face_count`` - 1.
            face_count: F.

        Raises:
            UserError: ``faces`` has another shape, or an index is out of range.
        """
        check_ids("faces", faces, shape=("N",), count=face_count)
        faces = faces.to(torch.int32).contiguous()
        return cls(faces, face_count, group_by(faces, face_count))

    def to(self, device: torch.device | str) -> FaceBinding:
        """The same binding on ``device``."""
        return FaceBinding(self.faces.to(device), self.face_count, self.gaussians.to(device))


def bind(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    normals: Tensor,
    binding: FaceBinding,
    frames: TriangleFrames,
) -> BoundGaussians:
    """Carry Gaussians from their triangles' frames to world space, differentiably in all but the binding.

    mu' = k r mu + t, q' = quat(r) q / |q|, s' = k s (Eq. lbs) and n' = norm(r n) (Eq. normal_transform). A
    zero quaternion counts as the identity and a zero normal stays zero; neither has a gradient. The sign of
    q' is arbitrary.

    The gradient with respect to r is the tangential one, G = [torque]x r / 2 with <G, [w]x r> = torque . w
    for every turn w: all that a rotation can follow, and free of the branches of quat(r).

    Args:
        means: (N, 3) float32 centres mu, in units of the triangle's k.
        quaternions: (N, 4) float32 rotations q (w, x, y, z) of any length.
        scales: (N, 3) float32 positive standard deviations s, in units of k.
        normals: (N, 3) float32 canonical normals n of any length.
        binding: The triangle of each Gaussian.
        frames: All F triangles' frames; ``rotation`` must be rotations.

    Raises:
        UserError: A tensor has another shape, dtype or device than the binding needs.
    """
    count, face_count = binding.faces.shape[0], binding.face_count
    check_tensors(
        ("means", means, (count, 3)),
        ("quaternions", quaternions, (count, 4)),
        ("scales", scales, (count, 3)),
        ("normals", normals, (count, 3)),
        ("frames.rotation", frames.rotation, (face_count, 3, 3)),
        ("frames.translation", frames.translation, (face_count, 3)),
        ("frames.scale", frames.scale, (face_count,)),
        device=binding.faces.device,
    )
    return BoundGaussians(*_Bind.apply(binding, means, quaternions, scales, normals, *frames))


class _Bind(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        binding: FaceBinding,
        means: Tensor,
        quaternions: Tensor,
        scales: Tensor,
        normals: Tensor,
        rotation: Tensor,
        translation: Tensor,
        scale: Tensor,
    ) -> tuple[Tensor, ...]:
        gaussians = [tensor.contiguous() for tensor in (means, quaternions, scales, normals)]
        frames = [tensor.contiguous() for tensor in (rotation, translation, scale)]
        bound = tuple(torch.empty_like(tensor) for tensor in gaussians)
        launch_range(_bind, binding.faces.shape[0], binding.faces, *gaussians, *frames, *bound, grain=GRAIN)
        ctx.save_for_backward(*gaussians, *frames)
        ctx.binding = binding
        return bound

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_means: Tensor, grad_quaternions: Tensor, grad_scales: Tensor, grad_normals: Tensor
    ) -> tuple[Tensor | None, ...]:
        binding: FaceBinding = ctx.binding
        inputs = ctx.saved_tensors
        grad_bound = [grad.contiguous() for grad in (grad_means, grad_quaternions, grad_scales, grad_normals)]
        grad_inputs = [torch.empty_like(tensor) for tensor in inputs]
        launch_range(
            _bind_adjoint,
            binding.face_count,
            *binding.gaussians,
            *inputs,
            *grad_bound,
            *grad_inputs,
            grain=GRAIN,
        )
        return None, *grad_inputs


@wp.func
def _unit_quaternion(wxyz: wp.vec4) -> wp.quat:
    """A unit quaternion in Warp's order (x, y, z, w); the identity for zero."""
    length = wp.length(wxyz)
    if length == 0.0:
        return wp.quat_identity()
    wxyz = wxyz / length
    return wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])


@wp.func
def _to_wxyz(q: wp.quat) -> wp.vec4:
    return wp.vec4(q[3], q[0], q[1], q[2])


@wp.kernel(enable_backward=False)
def _bind(
    first: wp.int32,
    faces: wp.array[wp.int32],
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    rotation: wp.array[wp.mat33],
    translation: wp.array[wp.vec3],
    scale: wp.array[wp.float32],
    bound_means: wp.array[wp.vec3],
    bound_quaternions: wp.array[wp.vec4],
    bound_scales: wp.array[wp.vec3],
    bound_normals: wp.array[wp.vec3],
) -> None:
    """One Gaussian."""
    index = first + wp.tid()
    face = faces[index]
    r = rotation[face]
    k = scale[face]
    bound_means[index] = k * (r * means[index]) + translation[face]
    bound_quaternions[index] = _to_wxyz(wp.quat_from_matrix(r) * _unit_quaternion(quaternions[index]))
    bound_scales[index] = k * scales[index]
    bound_normals[index] = wp.normalize(r * normals[index])


@wp.kernel(enable_backward=False)
def _bind_adjoint(
    first: wp.int32,
    offsets: wp.array[wp.int32],
    members: wp.array[wp.int32],
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    rotation: wp.array[wp.mat33],
    translation: wp.array[wp.vec3],
    scale: wp.array[wp.float32],
    grad_bound_means: wp.array[wp.vec3],
    grad_bound_quaternions: wp.array[wp.vec4],
    grad_bound_scales: wp.array[wp.vec3],
    grad_bound_normals: wp.array[wp.vec3],
    grad_means: wp.array[wp.vec3],
    grad_quaternions: wp.array[wp.vec4],
    grad_scales: wp.array[wp.vec3],
    grad_normals: wp.array[wp.vec3],
    grad_rotation: wp.array[wp.mat33],
    grad_translation: wp.array[wp.vec3],
    grad_scale: wp.array[wp.float32],
) -> None:
    """One triangle: the gradients of its Gaussians, and their sums for its frame."""
    face = first + wp.tid()

    # the frame, once for all of its Gaussians
    r = rotation[face]
    inverse = wp.transpose(r)
    k = scale[face]
    frame_quaternion = wp.quat_from_matrix(r)

    # what the frame gathers from them: of r the turn alone, of t, and of k
    torque = wp.vec3(0.0)
    force = wp.vec3(0.0)
    stretch = wp.float32(0.0)
    for entry in range(offsets[face], offsets[face + 1]):
        index = members[entry]

        # mu' = k r mu + t
        grad_mean = grad_bound_means[index]
        arm = r * means[index]
        grad_means[index] = k * (inverse * grad_mean)
        force += grad_mean
        torque += k * wp.cross(arm, grad_mean)
        stretch += wp.dot(arm, grad_mean)

        # s' = k s
        grad_bound_scale = grad_bound_scales[index]
        grad_scales[index] = k * grad_bound_scale
        stretch += wp.dot(scales[index], grad_bound_scale)

        # q' = quat(r) q / |q|: a turn w of r moves q' by w q' / 2, and what lies along q is lost to its
        # length
        wxyz = grad_bound_quaternions[index]
        grad_turned = wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
        local = _unit_quaternion(quaternions[index])
        spin = grad_turned * wp.quat_inverse(frame_quaternion * local)
        torque += 0.5 * wp.vec3(spin[0], spin[1], spin[2])
        grad_local = _to_wxyz(wp.quat_inverse(frame_quaternion) * grad_turned)
        local_wxyz = _to_wxyz(local)
        length = wp.length(quaternions[index])
        if length > 0.0:
            grad_quaternions[index] = (grad_local - local_wxyz * wp.dot(local_wxyz, grad_local)) / length
        else:
            grad_quaternions[index] = wp.vec4(0.0)

        # n' = norm(r n)
        grad_normal = grad_bound_normals[index]
        normal = wp.normalize(r * normals[index])
        length = wp.length(normals[index])
        if length > 0.0:
            grad_normals[index] = inverse * ((grad_normal - normal * wp.dot(normal, grad_normal)) / length)
            torque += wp.cross(normal, grad_normal)
        else:
            grad_normals[index] = wp.vec3(0.0)

    # the tangential gradient of r: <G, [w]x r> = torque . w for every turn w
    grad_rotation[face] = 0.5 * wp.skew(torque) * r
    grad_translation[face] = force
    grad_scale[face] = stretch
