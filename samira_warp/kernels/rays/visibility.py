"""Which points of a scene a viewpoint sees past a mesh."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 1024
"""Rays that are worth a thread."""


def visible(points: Tensor, mesh: RayMesh, *, origin: Tensor, offset: float = 1e-4) -> Tensor:
    """Tell which points see ``origin`` past the mesh, triangles blocking from both sides.

    Args:
        points: (M, 3) float32, usually on the mesh.
        mesh: What may stand between them, on the same device.
        origin: (3,) float32 viewpoint.
        offset: The last part of each ray, in the points' unit, is not tested, so that the surface a point
            lies on does not hide it. The default suits metres: thinner than a lid over an eyeball, far above
            float32's error at a camera's distance.

    Returns:
        (M,) bool.

    Raises:
        UserError: A tensor has another shape, dtype or device.
    """
    device = mesh.vertices.device
    check_tensors(("points", points, ("M", 3)), ("origin", origin, (3,)), device=device)
    result = torch.ones(points.shape[0], dtype=torch.bool, device=device)
    inputs = (points.contiguous(), origin.contiguous(), mesh.id, offset)
    launch_range(_visible, points.shape[0], *inputs, result, grain=GRAIN)
    return result


@wp.kernel(enable_backward=False)
def _visible(
    first: wp.int32,
    points: wp.array[wp.vec3],
    origin: wp.array[wp.float32],
    mesh: wp.uint64,
    offset: wp.float32,
    result: wp.array[wp.bool],
) -> None:
    """One point: a ray from the viewpoint that ends just short of it."""
    index = first + wp.tid()
    start = wp.vec3(origin[0], origin[1], origin[2])
    ray = points[index] - start
    distance = wp.length(ray)
    if distance > offset:
        result[index] = not wp.mesh_query_ray_anyhit(mesh, start, ray / distance, distance - offset)
