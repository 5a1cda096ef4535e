"""Which vertices, edges and triangles of a mesh meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.kernels.gathering.grouping import Groups, group_by
from samira_warp.support.validation import check_ids, check_tensor, check_tensors


class MeshEdges(NamedTuple):
    """The E edges of a mesh, each once.

    Attributes:
        ends: (E, 2) int32 vertex ids, the lower one first.
        opposites: (E, 2) int32: the third vertices of the edge's two triangles; the second is -1 where there
            is one triangle, or more than two.
        ends_of: For each vertex the ends that it is, numbered 2 * edge + end.
    """

    ends: Tensor
    opposites: Tensor
    ends_of: Groups


@dataclass(frozen=True, eq=False)
class MeshTopology:
    """The triangles of a mesh, and the corners that meet in each vertex.

    Attributes:
        faces: (F, 3) int32 vertex ids.
        vertex_count: V.
        corners: For each vertex its corners, numbered 3 * face + corner.
    """

    faces: Tensor
    vertex_count: int
    corners: Groups

    def __post_init__(self) -> None:
        check_tensor("faces", self.faces, shape=("F", 3), dtype=torch.int32)
        check_tensors(
            ("corners.offsets", self.corners.offsets, (self.vertex_count + 1,), torch.int32),
            ("corners.members", self.corners.members, (self.faces.numel(),), torch.int32),
            device=self.faces.device,
        )

    @classmethod
    def build(cls, faces: Tensor, vertex_count: int) -> MeshTopology:
        """List the corners of every vertex.

        Args:
            faces: (F, 3) integers from 0 to ``vertex_count`` - 1.
            vertex_count: V.

        Raises:
            UserError: ``faces`` has another shape, or an index is out of range.
        """
        check_ids("faces", faces, shape=("F", 3), count=vertex_count)
        faces = faces.to(torch.int32).contiguous()
        return cls(faces, vertex_count, group_by(faces.flatten(), vertex_count))

    def to(self, device: torch.device | str) -> MeshTopology:
        """The same topology on ``device``."""
        return MeshTopology(self.faces.to(device), self.vertex_count, self.corners.to(device))

    @cached_property
    def edges(self) -> MeshEdges:
        """The edges, found when they are first asked for."""
        # the side across from corner k runs from corner k + 1 to corner k + 2
        start, end = (self.faces.roll(-step, dims=1).flatten().long() for step in (1, 2))
        sides = (start != end).nonzero().squeeze(1)
        low, high = torch.minimum(start, end)[sides], torch.maximum(start, end)[sides]
        found, edge_of_side, triangles = torch.unique(
            low * self.vertex_count + high, return_inverse=True, return_counts=True
        )
        ends = torch.stack([found // self.vertex_count, found % self.vertex_count], dim=1).to(torch.int32)
        by_edge = group_by(edge_of_side, len(found))
        across = self.faces.flatten()[sides[by_edge.members]]
        one = by_edge.offsets[:-1]
        other = (one + 1).clamp(max=max(len(across) - 1, 0))
        opposites = torch.stack([across[one], torch.where(triangles == 2, across[other], -1)], dim=1)
        return MeshEdges(ends, opposites.contiguous(), group_by(ends.flatten(), self.vertex_count))
