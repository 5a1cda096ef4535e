"""Which points of a scene a viewpoint sees past a mesh."""

from __future__ import annotations

import torch
import warp as wp

from samira_warp.kernels.runtime import launch_range, stream_of, warp_array
from samira_warp.support.validation import check_tensor

_GRAIN = 1024
"""Fewer rays than this cost less than handing them to a thread."""


def visible(
    points: torch.Tensor,
    *,
    vertices: torch.Tensor,
    faces: torch.Tensor,
    origin: torch.Tensor,
    offset: float = 1e-4,
) -> torch.Tensor:
    """Tell which points see ``origin`` past the mesh, triangles blocking from both sides.

    Args:
        points: (M, 3) float32, usually on the mesh.
        vertices: (V, 3) float32, on the same device.
        faces: (F, 3) integer vertex ids.
        origin: (3,) float32 viewpoint.
        offset: The last part of each ray, in the points' unit, is not tested, so that the surface a point
            lies on does not hide it. The default suits metres: thinner than a lid over an eyeball, far above
            float32's error at a camera's distance.

    Returns:
        (M,) bool.

    Raises:
        UserError: A tensor has another shape, dtype or device.
    """
    device = points.device
    check_tensor("points", points, shape=("M", 3))
    check_tensor("vertices", vertices, shape=("V", 3), device=device)
    check_tensor("faces", faces, shape=("F", 3), dtype=None, device=device)
    check_tensor("origin", origin, shape=(3,), device=device)
    result = torch.ones(points.shape[0], dtype=torch.bool, device=device)
    if faces.shape[0] == 0:
        return result
    vertices, indices = vertices.contiguous(), faces.to(torch.int32).flatten().contiguous()
    with stream_of(device):
        mesh = wp.Mesh(points=warp_array(vertices, wp.vec3), indices=warp_array(indices, wp.int32))
        launch_range(
            _visible,
            points.shape[0],
            points.contiguous(),
            origin.contiguous(),
            mesh.id,
            offset,
            result,
            grain=_GRAIN,
        )
        del mesh
    return result


@wp.kernel(enable_backward=False)
def _visible(
    first: wp.int32,
    points: wp.array(dtype=wp.vec3),
    origin: wp.array(dtype=wp.float32),
    mesh: wp.uint64,
    offset: wp.float32,
    result: wp.array(dtype=wp.bool),
) -> None:
    """One point: a ray from the viewpoint that ends just short of it."""
    index = first + wp.tid()
    start = wp.vec3(origin[0], origin[1], origin[2])
    ray = points[index] - start
    distance = wp.length(ray)
    if distance > offset:
        hit = wp.mesh_query_ray(mesh, start, ray / distance, distance - offset)
        result[index] = not hit.result
