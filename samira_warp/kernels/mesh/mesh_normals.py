"""Unit normals at the vertices of posed meshes, for many frames at once."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 1024
"""Vertices that are worth a thread."""


def mesh_normals(vertices: Tensor, topology: MeshTopology) -> Tensor:
    """Normals of every vertex in every frame, differentiably in ``vertices``.

    They are the mean of the adjacent triangles' normals, weighted by area; 0, and a constant, where there is
    no triangle with an area.

    Args:
        vertices: (B, V, 3) float32.
        topology: The mesh, on the same device.

    Returns:
        (B, V, 3) float32 unit vectors, out of the side from which triangles are counterclockwise.

    Raises:
        UserError: ``vertices`` has another shape, dtype or device than the topology needs.
    """
    check_tensors(("vertices", vertices, ("B", topology.vertex_count, 3)), device=topology.faces.device)
    return _MeshNormals.apply(vertices, topology)


class _MeshNormals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices: Tensor, topology: MeshTopology) -> Tensor:
        vertices = vertices.contiguous()
        normals, lengths = torch.empty_like(vertices), vertices.new_empty(vertices.shape[:2])
        mesh = (vertices, topology.faces, *topology.corners)
        launch_range(_normals, lengths.numel(), *mesh, normals, lengths, grain=GRAIN)
        ctx.save_for_backward(vertices, normals, lengths)
        ctx.topology = topology
        return normals

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_normals: Tensor) -> tuple[Tensor, None]:
        vertices, normals, lengths = ctx.saved_tensors
        topology: MeshTopology = ctx.topology
        grad_sums, grad_vertices = torch.empty_like(normals), torch.empty_like(vertices)
        grads = (grad_normals.contiguous(), grad_sums)
        launch_range(_normalize_adjoint, lengths.numel(), normals, lengths, *grads, grain=GRAIN)
        mesh = (vertices, topology.faces, *topology.corners)
        launch_range(_gather_vertex, lengths.numel(), *mesh, grad_sums, grad_vertices, grain=GRAIN)
        return grad_vertices, None


@wp.kernel(enable_backward=False)
def _normals(
    first: wp.int32,
    vertices: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    offsets: wp.array[wp.int32],
    corners: wp.array[wp.int32],
    normals: wp.array2d[wp.vec3],
    lengths: wp.array2d[wp.float32],
) -> None:
    """One vertex of one frame: the direction and the length of the sum of (b - a) x (c - a)."""
    index = first + wp.tid()
    frame = index // vertices.shape[1]
    vertex = index - frame * vertices.shape[1]
    total = wp.vec3(0.0)
    for entry in range(offsets[vertex], offsets[vertex + 1]):
        face = corners[entry] // 3
        a = vertices[frame, faces[face, 0]]
        total += wp.cross(vertices[frame, faces[face, 1]] - a, vertices[frame, faces[face, 2]] - a)
    lengths[frame, vertex] = wp.length(total)
    normals[frame, vertex] = wp.normalize(total)


@wp.kernel(enable_backward=False)
def _normalize_adjoint(
    first: wp.int32,
    normals: wp.array2d[wp.vec3],
    lengths: wp.array2d[wp.float32],
    grad_normals: wp.array2d[wp.vec3],
    grad_sums: wp.array2d[wp.vec3],
) -> None:
    """One vertex of one frame: the gradient of the sum, whose length is lost."""
    index = first + wp.tid()
    frame = index // normals.shape[1]
    vertex = index - frame * normals.shape[1]
    grad_sum = wp.vec3(0.0)
    length = lengths[frame, vertex]
    if length > 0.0:
        normal = normals[frame, vertex]
        grad = grad_normals[frame, vertex]
        grad_sum = (grad - normal * wp.dot(normal, grad)) / length
    grad_sums[frame, vertex] = grad_sum


@wp.kernel(enable_backward=False)
def _gather_vertex(
    first: wp.int32,
    vertices: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    offsets: wp.array[wp.int32],
    corners: wp.array[wp.int32],
    grad_sums: wp.array2d[wp.vec3],
    grad_vertices: wp.array2d[wp.vec3],
) -> None:
    """One vertex of one frame: what its triangles' area vectors hand on to it."""
    index = first + wp.tid()
    frame = index // vertices.shape[1]
    vertex = index - frame * vertices.shape[1]
    total = wp.vec3(0.0)
    for entry in range(offsets[vertex], offsets[vertex + 1]):
        face = corners[entry] // 3
        corner = corners[entry] - 3 * face
        b = faces[face, (corner + 1) % 3]
        c = faces[face, (corner + 2) % 3]
        # the area vector a x b + b x c + c x a is in the sums of all three corners
        grad_area = grad_sums[frame, vertex] + grad_sums[frame, b] + grad_sums[frame, c]
        total += wp.cross(vertices[frame, b] - vertices[frame, c], grad_area)
    grad_vertices[frame, vertex] = total
