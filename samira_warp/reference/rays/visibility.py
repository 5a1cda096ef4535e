"""The visibility of `samira_warp.kernels.rays.visibility` in plain torch: all rays against all triangles."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.reference.rays.ray_mesh import RayMesh


def visible(points: Tensor, mesh: RayMesh, *, origin: Tensor, offset: float = 1e-4) -> Tensor:
    """(M,) bool: no triangle meets the segment from ``origin`` to within ``offset`` of each of the points.

    The points are (M, 3), the viewpoint is (3,). Moeller and Trumbore, Fast, Minimum Storage Ray-Triangle
    Intersection, 1997.
    """
    ray = (points - origin)[:, None]
    distance = ray.norm(dim=-1)
    ray = ray / distance[..., None].clamp(min=1e-30)
    a, b, c = mesh.vertices[mesh.faces.long()].unbind(dim=1)
    across = torch.linalg.cross(ray, (c - a)[None])
    determinant = ((b - a) * across).sum(dim=-1)
    inverse = 1 / torch.where(determinant == 0, torch.nan, determinant)
    u = ((origin - a) * across).sum(dim=-1) * inverse
    other = torch.linalg.cross(origin - a, b - a)
    v = (ray * other).sum(dim=-1) * inverse
    depth = ((c - a) * other).sum(dim=-1) * inverse
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > 0) & (depth < distance - offset)
    return ~hit.any(dim=1)
