"""The directions of `samira_warp.kernels.rays.occlusion` in plain torch: all rays against all triangles."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.reference.rays.ray_mesh import RayMesh


class Unblocked(NamedTuple):
    """What M points see in D directions.

    Attributes:
        bits: (M, D / 32) int32, packed as the kernels do.
        margins: (M, D), how far, in the points' unit, a ray or a mesh would have to move for another answer,
            at least; for a direction on the horizon the sine of its height times the mesh's size. Infinite
            where no ray is cast.
    """

    bits: Tensor
    margins: Tensor


def unblocked(
    points: Tensor, normals: Tensor, mesh: RayMesh, directions: Tensor, *, offset: float = 1e-6
) -> Unblocked:
    """The mesh against rays from (M, 3) points in (D, 3) directions, point by point.

    A ray meets a triangle where it passes its three edges on the same side and its plane ahead.
    """
    rows = [
        _depths(mesh, point + offset * normal, directions)
        for point, normal in zip(points, normals, strict=True)
    ]
    depths = torch.stack(rows) if rows else points.new_empty(0, len(directions))
    cosines = normals @ directions.T
    cast = cosines > 0
    margins = torch.where(cast, depths.abs(), torch.inf)
    if mesh.faces.numel():
        size = (mesh.vertices.amax(dim=0) - mesh.vertices.amin(dim=0)).norm()
        margins = torch.where(cosines == 0, torch.inf, torch.minimum(margins, cosines.abs() * size))
    return Unblocked(_pack(~cast | (depths < 0)), margins)


def _depths(mesh: RayMesh, start: Tensor, directions: Tensor) -> Tensor:
    """(D,) how deep each ray goes into the triangle that it goes into deepest; negative where it misses all.

    Into a triangle it is the least of the distances of the ray's line from the lines of the edges, and of the
    start from the plane.
    """
    corners = mesh.vertices[mesh.faces.long()] - start
    edges = corners.roll(-1, dims=1) - corners
    areas = torch.linalg.cross(edges[:, 0], edges[:, 1])
    whole = areas.norm(dim=-1) > 0
    corners, edges, areas = corners[whole], edges[whole], areas[whole]
    if not len(corners):
        return directions.new_full((len(directions),), -torch.inf)
    facing = areas @ directions.T
    side = torch.where(facing < 0, -1.0, 1.0)
    moments = torch.linalg.cross(corners, edges)
    across = torch.linalg.cross(directions[:, None, None], edges[None]).norm(dim=-1)
    inside = (moments @ directions.T).movedim(-1, 0) / across.clamp(min=1e-300)
    inside = (inside * side.T[..., None]).amin(dim=-1)
    height = (corners[:, 0] * areas).sum(dim=-1) / areas.norm(dim=-1)
    return torch.minimum(inside, side.T * height).amax(dim=1)


def _pack(bits: Tensor) -> Tensor:
    """(M, D / 32) int32 of (M, D) bool, the first the least significant."""
    weights = torch.bitwise_left_shift(torch.ones(32, dtype=torch.int64), torch.arange(32)).to(bits.device)
    return (bits.view(len(bits), -1, 32) * weights).sum(dim=-1).to(torch.int32)
