"""Where Gaussians read values of the mesh: in its UV atlas (Alg. 1), and from the corners of their faces."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.head import UvAtlas
from samira_warp.kernels.gathering.gather import GatherTable
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


def corner_table(uv: Tensor, faces: Tensor, *, topology: MeshTopology, atlas: UvAtlas) -> GatherTable:
    """The map from values of vertices to Gaussians: barycentric, where the atlas has them on their faces.

    Args:
        uv: (N, 2) places in the atlas.
        faces: (N,) int32 faces.
        topology: The mesh.
        atlas: Its UV atlas.
    """
    corners = atlas.vt[atlas.ft[faces.long()].long()].double()
    edges = (corners[:, 1:] - corners[:, :1]).mT
    area = torch.linalg.det(edges)
    place = (uv.detach().double() - corners[:, 0])[..., None]
    flat = area.abs() <= 1e-12
    edges = torch.where(flat[:, None, None], torch.eye(2, dtype=edges.dtype, device=edges.device), edges)
    second_third = torch.linalg.solve(edges, place)[..., 0]
    weights = torch.cat([1.0 - second_third.sum(dim=1, keepdim=True), second_third], dim=1).clamp(0.0, 1.0)
    weights = torch.where(flat[:, None], 1.0, weights)
    weights = weights / weights.sum(dim=1, keepdim=True)
    vertices = topology.faces[faces.long()]
    return GatherTable.build(vertices, weights.float(), sources=topology.vertex_count)
