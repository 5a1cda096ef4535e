"""The closest point of `samira_warp.kernels.mesh.barycentric` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor


def closest_barycentrics(points: Tensor, triangles: Tensor) -> Tensor:
    """Weights (N, 3) of the corners (N, 3, 3) at each triangle's point closest to its own point (N, 3).

    Said without Voronoi regions: the closest of the three edges' closest points, unless the foot of the
    perpendicular lies inside.
    """
    corners = triangles.unbind(dim=1)
    eye = torch.eye(3, dtype=points.dtype, device=points.device)
    candidates = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[j] - corners[i]
        squared = (edge * edge).sum(dim=1, keepdim=True)
        along = ((points - corners[i]) * edge).sum(dim=1, keepdim=True) / torch.where(squared > 0, squared, 1)
        along = along.clamp(0, 1)
        candidates.append((1 - along) * eye[i] + along * eye[j])
    weights = torch.stack(candidates, dim=1)
    distances = (weights @ triangles - points[:, None]).norm(dim=2)
    closest = weights[torch.arange(len(points), device=points.device), distances.argmin(dim=1)]

    foot = _foot(points, *corners)
    inside = foot.isfinite().all(dim=1) & (foot >= 0).all(dim=1)
    return torch.where(inside[:, None], foot, closest)


def _foot(p: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """Weights of the foot of the perpendicular from p to the triangle's plane; not finite without a plane."""
    normal = torch.linalg.cross(b - a, c - a)
    squared = (normal * normal).sum(dim=1)
    weights = [
        (torch.linalg.cross(j - i, p - i) * normal).sum(dim=1) / squared for i, j in ((b, c), (c, a), (a, b))
    ]
    return torch.stack(weights, dim=1)
