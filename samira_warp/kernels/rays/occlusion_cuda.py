"""Blocked directions on a GPU: a plain Warp kernel over Warp's own tree.

A thread has one word of one point; neighbouring threads have the same word of neighbouring points, so that
what runs together casts the same direction from nearly the same place.
"""

from __future__ import annotations

import warp as wp
from torch import Tensor

from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch_range

FAR = 1e30
"""Longer than any ray, in the mesh's unit."""

GRAIN = 32
"""Words that are worth a thread."""


def occlusion(
    points: Tensor, normals: Tensor, mesh: RayMesh, directions: Tensor, offset: float, result: Tensor
) -> None:
    """Write the bits of `samira_warp.kernels.rays.occlusion.unblocked`."""
    inputs = (points, normals, mesh.id, directions, offset)
    launch_range(_cast_word, result.numel(), *inputs, result, grain=GRAIN)


@wp.kernel(enable_backward=False)
def _cast_word(
    first: wp.int32,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    mesh: wp.uint64,
    directions: wp.array[wp.vec3],
    offset: wp.float32,
    result: wp.array2d[wp.int32],
) -> None:
    """One word: 32 directions of a point."""
    index = first + wp.tid()
    word, point = index / points.shape[0], index % points.shape[0]
    normal = normals[point]
    start = points[point] + offset * normal
    bits = wp.int32(-1)
    for k in range(32):
        direction = directions[32 * word + k]
        if wp.dot(normal, direction) <= 0.0:
            continue
        if wp.mesh_query_ray_anyhit(mesh, start, direction, FAR):
            bits &= ~(1 << k)
    result[point, word] = bits
