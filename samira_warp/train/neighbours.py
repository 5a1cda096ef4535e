"""Which Gaussians are neighbours on the surface, and what they differ from each other by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from samira_warp.avatar import CanonicalHead, Gaussians
from samira_warp.kernels.gathering.gather import GatherTable, bilinear_table, gather
from samira_warp.kernels.mesh.triangle_frames import triangle_frames

NEIGHBOURS = 8
"""A ring of the eight around a square's middle."""

NORMAL_METRES = 0.01
"""What a right angle between two normals is worth in metres: the lips' insides touch, and are no
neighbours."""

_APART = 10.0
"""Metres between two pieces of the mesh: an eyeball touches its lids, and is of other stuff."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The neighbours of N Gaussians on the head at rest.

    Attributes:
        table: (N,) means over each one's neighbours.
        places: (N, 7) float64 where they are, see `rest_places`.
    """

    table: GatherTable
    places: np.ndarray

    def contrast(self, values: Tensor) -> Tensor:
        """(N, C) values less the mean over the neighbours'."""
        return values - gather(values, self.table)


@torch.no_grad()
def neighbourhood(gaussians: Gaussians, canonical: CanonicalHead) -> Neighbourhood:
    """Find the neighbours of Gaussians as they stand."""
    places = rest_places(gaussians, canonical)
    count = min(NEIGHBOURS, len(places) - 1)
    _, found = cKDTree(places).query(places, k=count + 1)
    others = found[found != np.arange(len(places))[:, None]]
    if len(others) != count * len(places):
        # Gaussians in one place: any of them may come first, so each leaves its last one out instead
        others = np.array([[j for j in row if j != i][:count] for i, row in enumerate(found)])
    indices = torch.from_numpy(others.reshape(len(places), count).astype(np.int32))
    weights = torch.full(indices.shape, 1.0 / count)
    device = gaussians.means.device
    table = GatherTable.build(indices.to(device), weights.to(device), sources=len(places))
    return Neighbourhood(table, places)


def rest_places(gaussians: Gaussians, canonical: CanonicalHead) -> np.ndarray:
    """(N, 7) float64 places of Gaussians on the surface of the head at rest.

    A place is a position, a normal, and the piece of the mesh, in metres: neighbours are near each other. It
    follows from what is constant between refreshes of `Gaussians.uv`, so a run that goes on finds the same.
    """
    faces, size = gaussians.faces.long(), canonical.atlas.size
    rotation = triangle_frames(canonical.vertices, canonical.topology).rotation[faces]
    surface = canonical.atlas.dilate(canonical.positions).flatten(0, 1)
    positions = gather(surface, bilinear_table(gaussians.uv, width=size, height=size))
    normals = NORMAL_METRES * (rotation @ gaussians.initial_normals[:, :, None])[:, :, 0]
    pieces = torch.from_numpy(_pieces(canonical)).to(faces.device)[faces]
    return torch.cat([positions, normals, _APART * pieces[:, None]], dim=1).double().cpu().numpy()


def _pieces(canonical: CanonicalHead) -> np.ndarray:
    """(F,) float32 number of the connected piece of the mesh that each face is of."""
    faces, count = canonical.topology.faces.cpu().numpy(), len(canonical.vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    return labels[faces[:, 0]].astype(np.float32)
