"""The normals of `samira_warp.kernels.mesh.mesh_normals` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.topology import MeshTopology


def mesh_normals(vertices: Tensor, topology: MeshTopology) -> Tensor:
    """Sums of the adjacent area vectors, normalised: (B, V, 3); 0 and constant where they vanish."""
    faces = topology.faces.long()
    a, b, c = vertices[:, faces].unbind(dim=2)
    doubled = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(vertices)
    for corner in range(3):
        total = total.index_add(1, faces[:, corner], doubled)
    vanishes = (total == 0).all(dim=-1, keepdim=True)
    total = torch.where(vanishes, 1.0, total)
    return torch.where(vanishes, 0.0, total / total.norm(dim=-1, keepdim=True))
