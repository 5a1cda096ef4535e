"""Wrinkles: shading that moves with an expression, which Gaussians that move cannot make.

Beyond the paper: the motion network's decoder gives slopes as well, which turn the normals and nothing else,
in the tangent frame of the UV atlas, so that a forehead that frowns is lit as one under any light.
"""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.head import UvAtlas
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import triangle_frames

SLOPE_LIMIT = 1.0
"""Tangent of the steepest turn of a normal along each axis of the atlas: the side of a deep crease."""


def face_tangents(vertices: Tensor, topology: MeshTopology, atlas: UvAtlas) -> Tensor:
    """(F, 2, 3) unit directions in which u and v grow on every face, in the axes of the face's own frame.

    They go with the face as it turns. Zero where a face has no area in space or in the atlas.

    Args:
        vertices: (V, 3) the reference mesh.
        topology: Its faces.
        atlas: Its UV atlas.
    """
    corners = vertices[topology.faces.long()].double()
    places = atlas.vt[atlas.ft.long()].double()
    edges = corners[:, 1:] - corners[:, :1]
    steps = places[:, 1:] - places[:, :1]
    flat = torch.linalg.det(steps).abs() < 1e-12
    steps = torch.where(flat[:, None, None], torch.eye(2, dtype=steps.dtype, device=steps.device), steps)
    along = torch.linalg.solve(steps, edges)
    along = torch.where(flat[:, None, None], 0.0, along)
    rotation = triangle_frames(vertices, topology).rotation.double()
    return torch.nn.functional.normalize(along @ rotation, dim=-1).float()


def wrinkled(normals: Tensor, slopes: Tensor, tangents: Tensor) -> Tensor:
    """Normals (N, 3) of any length, turned by slopes (N, 2) along tangents (N, 2, 3); not normalised."""
    return torch.nn.functional.normalize(normals, dim=-1) + (slopes[:, :, None] * tangents).sum(dim=1)
