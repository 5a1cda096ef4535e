"""A head's mesh as other programs know one: a vertex for each pair of a place and its UV coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head import HeadTemplate
from samira_warp.head.uv_layout import with_one_atlas


class SplitMesh(NamedTuple):
    """A template's faces over M vertices, V of the head's and again where charts of its atlas part.

    Attributes:
        source: (M,) int64 which of the head's vertices each is.
        uv: (M, 2) float32 u to the right, v up.
        faces: (F, 3) int64 their ids.
        head_faces: (F, 3) int64 the same faces by the head's own vertices.
    """

    source: Tensor
    uv: Tensor
    faces: Tensor
    head_faces: Tensor

    @classmethod
    def of(cls, template: HeadTemplate) -> SplitMesh:
        """The mesh of a template, on the CPU; vertices in the order of the head's own.

        Its atlas is the template's where every point has a texel of its own in it, else one of xatlas's.

        Raises:
            UserError: xatlas is needed and not installed, or cannot make an atlas of the head.
        """
        template = with_one_atlas(template)
        pairs, corners = np.unique(
            np.stack([template.faces.ravel(), template.ft.ravel()], axis=1), axis=0, return_inverse=True
        )
        return cls(
            source=torch.from_numpy(pairs[:, 0].astype(np.int64)),
            uv=torch.from_numpy(template.vt[pairs[:, 1]]),
            faces=torch.from_numpy(corners.reshape(-1, 3).astype(np.int64)),
            head_faces=torch.from_numpy(template.faces.astype(np.int64)),
        )


class TangentFrames(NamedTuple):
    """Directions at the vertices of a `SplitMesh`, for normal maps.

    Attributes:
        normals: (M, 3) unit; up where there is no face with an area.
        tangents: (M, 3) unit, at right angles to the normals: where u grows.
        signs: (M,) 1 or -1: cross(normal, tangent) times this is where v grows.
    """

    normals: Tensor
    tangents: Tensor
    signs: Tensor

    @property
    def bitangents(self) -> Tensor:
        """(M, 3) unit: where v grows, at right angles to both others."""
        return torch.linalg.cross(self.normals, self.tangents) * self.signs[:, None]


def tangent_frames(vertices: Tensor, mesh: SplitMesh) -> TangentFrames:
    """The frames of a posed head.

    Normals are smooth across the seams of the atlas, tangents are each chart's own.

    Args:
        vertices: (V, 3) float32, the head's own.
        mesh: Its faces, on the same device.
    """
    up = vertices.new_tensor([0.0, 1.0, 0.0])
    normals = vertex_normals(vertices, mesh.head_faces)
    normals = torch.where(normals.norm(dim=1, keepdim=True) > 0.5, normals, up)[mesh.source]
    along_u, along_v = _gradients(vertices[mesh.head_faces], mesh.uv[mesh.faces])
    tangents, bitangents = torch.zeros_like(normals), torch.zeros_like(normals)
    for corner in range(3):
        tangents = tangents.index_add(0, mesh.faces[:, corner], along_u)
        bitangents = bitangents.index_add(0, mesh.faces[:, corner], along_v)
    tangents = _perpendicular(tangents, normals)
    handed = (torch.linalg.cross(normals, tangents) * bitangents).sum(dim=1) >= 0.0
    return TangentFrames(normals, tangents, torch.where(handed, 1.0, -1.0))


def _gradients(corners: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """(F, 3) directions in which u and v grow on faces, times their areas in space.

    Args:
        corners: (F, 3, 3) places in space.
        places: (F, 3, 2) places in the atlas.
    """
    first, second = (corners[:, 1:] - corners[:, :1]).unbind(dim=1)
    (u1, v1), (u2, v2) = (
        (step[:, :1], step[:, 1:]) for step in (places[:, 1:] - places[:, :1]).unbind(dim=1)
    )
    turned = torch.sign(u1 * v2 - u2 * v1)
    area = torch.linalg.cross(first, second).norm(dim=1, keepdim=True)
    along_u, along_v = turned * (v2 * first - v1 * second), turned * (u1 * second - u2 * first)
    return area * normalize(along_u, dim=1, eps=1e-30), area * normalize(along_v, dim=1, eps=1e-30)


def _perpendicular(tangents: Tensor, normals: Tensor) -> Tensor:
    """(M, 3) unit vectors at right angles to normals, as near to the tangents as can be, if any is."""
    left = tangents - (tangents * normals).sum(dim=1, keepdim=True) * normals
    lost = left.norm(dim=1, keepdim=True) <= 1e-6 * tangents.norm(dim=1, keepdim=True)
    axes = torch.eye(3, dtype=normals.dtype, device=normals.device)
    other = torch.linalg.cross(normals, axes[normals.abs().argmin(dim=1)])
    return normalize(torch.where(lost, other, left), dim=1, eps=1e-30)
