"""Geometry-based UV sampling (Alg. 1): where in the atlas each Gaussian reads residual and response."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.head import UvAtlas
from samira_warp.kernels.mesh.barycentric import closest_barycentrics
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import triangle_frames


@torch.no_grad()
def geometry_uv(
    means: Tensor,
    face_ids: Tensor,
    *,
    vertices: Tensor,
    topology: MeshTopology,
    atlas: UvAtlas,
) -> Tensor:
    """UV coordinates u_i of Gaussians bound to a mesh.

    Args:
        means: (N, 3) centres in their triangle's frame, in units of its scale.
        face_ids: (N,) int32 bound faces.
        vertices: (V, 3) the reference mesh, without residuals.
        topology: Its faces.
        atlas: Its UV atlas.

    Returns:
        (N, 2) u right, v up.
    """
    frames = triangle_frames(vertices, topology)
    faces = face_ids.long()
    points = (
        frames.scale[faces, None] * torch.einsum("nij,nj->ni", frames.rotation[faces], means)
        + frames.translation[faces]
    )
    triangles = vertices[topology.faces[faces].long()]
    return atlas.uv_of(face_ids, closest_barycentrics(points.contiguous(), triangles.contiguous()))
