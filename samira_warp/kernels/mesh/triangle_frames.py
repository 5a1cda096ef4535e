"""A rotation, a centre and a scale for every triangle of a mesh, as GaussianAvatars defines them."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.gathering.sums import sum_groups
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import DEGENERATE_TRIANGLE
from samira_warp.support.validation import check_tensor

GRAIN = 2048
"""Triangles that are worth a thread."""


class TriangleFrames(NamedTuple):
    """The frames r, t and k of Eq. lbs.

    Attributes:
        rotation: (F, 3, 3) r, with columns (first edge's direction, face normal, third axis).
        translation: (F, 3) t, the centroid, in the vertices' unit.
        scale: (F,) k, half the sum of the first edge's length and the height over it, in the vertices' unit.
    """

    rotation: Tensor
    translation: Tensor
    scale: Tensor


def triangle_frames(vertices: Tensor, topology: MeshTopology) -> TriangleFrames:
    """Compute every triangle's frame, differentiably in ``vertices``.

    With a, b, c the corners: the first column is unit(b - a), the second the unit normal of (a, b, c), the
    third their cross product, so that r is a rotation; k is (|b - a| + height of c over ab) / 2. A degenerate
    triangle (no length, or no height to speak of) has r = identity, and its r and k are constants; its
    centroid is not.

    Args:
        vertices: (V, 3) float32.
        topology: The mesh, on the same device.

    Returns:
        The frames of all F triangles.

    Raises:
        UserError: ``vertices`` has another shape, dtype or device than the topology needs.
    """
    check_tensor("vertices", vertices, shape=(topology.vertex_count, 3), device=topology.faces.device)
    return TriangleFrames(*_TriangleFrames.apply(vertices, topology))


class _TriangleFrames(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices: Tensor, topology: MeshTopology) -> tuple[Tensor, Tensor, Tensor]:
        vertices = vertices.contiguous()
        ctx.save_for_backward(vertices)
        ctx.topology = topology
        count = topology.faces.shape[0]
        rotation, translation = vertices.new_empty(count, 3, 3), vertices.new_empty(count, 3)
        scale = vertices.new_empty(count)
        launch_range(
            _triangle_frames, count, vertices, topology.faces, rotation, translation, scale, grain=GRAIN
        )
        return rotation, translation, scale

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_rotation: Tensor, grad_translation: Tensor, grad_scale: Tensor
    ) -> tuple[Tensor, None]:
        (vertices,) = ctx.saved_tensors
        topology: MeshTopology = ctx.topology
        count = topology.faces.shape[0]
        grad_frames = [grad.contiguous() for grad in (grad_rotation, grad_translation, grad_scale)]
        grad_corners = vertices.new_empty(count * 3, 3)
        launch_range(
            _triangle_frames_adjoint, count, vertices, topology.faces, *grad_frames, grad_corners, grain=GRAIN
        )
        return sum_groups(grad_corners[None], topology.corners)[0], None


@wp.func
def _is_degenerate(length: wp.float32, height: wp.float32, side: wp.float32) -> wp.bool:
    return not (length > 0.0 and height > DEGENERATE_TRIANGLE * wp.max(length, side))


@wp.kernel(enable_backward=False)
def _triangle_frames(
    first: wp.int32,
    vertices: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    rotation: wp.array[wp.mat33],
    translation: wp.array[wp.vec3],
    scale: wp.array[wp.float32],
) -> None:
    """One triangle."""
    face = first + wp.tid()
    a = vertices[faces[face, 0]]
    b = vertices[faces[face, 1]]
    c = vertices[faces[face, 2]]
    edge = b - a
    side = c - a
    length = wp.length(edge)
    edge_direction = wp.normalize(edge)
    perpendicular = wp.cross(edge_direction, side)
    height = wp.length(perpendicular)
    translation[face] = (a + b + c) / 3.0
    scale[face] = 0.5 * (length + height)
    if _is_degenerate(length, height, wp.length(side)):
        rotation[face] = wp.identity(n=3, dtype=wp.float32)
    else:
        normal = perpendicular / height
        rotation[face] = wp.matrix_from_cols(edge_direction, normal, wp.cross(edge_direction, normal))


@wp.kernel(enable_backward=False)
def _triangle_frames_adjoint(
    first: wp.int32,
    vertices: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    grad_rotation: wp.array[wp.mat33],
    grad_translation: wp.array[wp.vec3],
    grad_scale: wp.array[wp.float32],
    grad_corners: wp.array[wp.vec3],
) -> None:
    """One triangle's gradients, to its own three corners."""
    # the frame again, as far as it was not kept
    face = first + wp.tid()
    a = vertices[faces[face, 0]]
    edge = vertices[faces[face, 1]] - a
    side = vertices[faces[face, 2]] - a
    length = wp.length(edge)
    edge_direction = wp.normalize(edge)
    perpendicular = wp.cross(edge_direction, side)
    height = wp.length(perpendicular)

    # r and k are functions of two edges; where they degenerate they are constants
    grad_edge = wp.vec3(0.0)
    grad_side = wp.vec3(0.0)
    if not _is_degenerate(length, height, wp.length(side)):
        # r = (direction, normal, direction x normal), k = (length + height) / 2
        normal = perpendicular / height
        columns = wp.transpose(grad_rotation[face])
        half_grad_scale = 0.5 * grad_scale[face]
        grad_direction = columns[0] + wp.cross(normal, columns[2])
        grad_normal = columns[1] + wp.cross(columns[2], edge_direction)
        # perpendicular = direction x side: its length is the height, its direction the normal
        grad_perpendicular = (
            grad_normal - normal * wp.dot(normal, grad_normal)
        ) / height + normal * half_grad_scale
        grad_direction += wp.cross(side, grad_perpendicular)
        grad_side = wp.cross(grad_perpendicular, edge_direction)
        along = wp.dot(edge_direction, grad_direction)
        grad_edge = (grad_direction - edge_direction * along) / length + edge_direction * half_grad_scale

    # to the corners, each shared by other triangles: `sum_groups` adds them up in a fixed order
    grad_centroid = grad_translation[face] / 3.0
    grad_corners[3 * face] = grad_centroid - grad_edge - grad_side
    grad_corners[3 * face + 1] = grad_centroid + grad_edge
    grad_corners[3 * face + 2] = grad_centroid + grad_side
