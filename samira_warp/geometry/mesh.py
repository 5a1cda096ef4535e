"""Normals and areas of a triangle mesh, for building things once; differentiable, in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """(V, 3) unit normals of (V, 3) vertices.

    They are the mean of the adjacent (F, 3) faces' normals, weighted by area; 0 where there is none.
    """
    doubled = _doubled_area_vectors(vertices, faces)
    total = torch.zeros_like(vertices)
    for corner in range(3):
        total = total.index_add(0, faces[:, corner].long(), doubled)
    return torch.nn.functional.normalize(total, dim=1, eps=1e-30)


def face_areas(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F,) areas of the (F, 3) faces, in the square of the unit of the (V, 3) vertices."""
    return _doubled_area_vectors(vertices, faces).norm(dim=1) / 2


def _doubled_area_vectors(vertices: Tensor, faces: Tensor) -> Tensor:
    a, b, c = vertices[faces.long()].unbind(dim=1)
    return torch.linalg.cross(b - a, c - a)
