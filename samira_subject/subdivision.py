"""One level of Loop's subdivision (Loop, 1987; Warren's weights).

It rounds a template's outline before rays meet it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor

EDGE_ENDS, EDGE_OPPOSITES = 3.0 / 8.0, 1.0 / 8.0
"""Weights of a new vertex on an inner edge: each end of the edge, and each corner that faces it."""

BORDER_SELF, BORDER_NEIGHBOUR = 3.0 / 4.0, 1.0 / 8.0
"""Weights of an old vertex on a border, which moves along the border alone: two parts that meet there stay
together."""


@dataclass(frozen=True, eq=False)
class LoopSubdivision:
    """The finer mesh of a triangle mesh, as a linear map of its vertices.

    Parts that share no vertex stay apart. An edge with other than two faces is a border: the curve along it
    depends on nothing beside it. Vertices at which other than two borders meet stay where they are.

    Attributes:
        weights: (V + E, V) float32, each row summing to 1: the old vertices' new places, then a vertex for
            each of the E edges.
        faces: (4 F, 3) int32; face f becomes 4 f to 4 f + 3, its three corners and its middle.
    """

    weights: csr_array
    faces: Tensor

    @classmethod
    def build(cls, faces: np.ndarray, *, vertices: int) -> LoopSubdivision:
        """The map of a mesh.

        Args:
            faces: (F, 3) integer vertex ids, no face twice.
            vertices: V.
        """
        faces = faces.astype(np.int64)
        # the half-edge at 3 f + k leads from corner k to the next one and faces the one before
        half_edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
        opposites = np.roll(faces, 1, axis=1).ravel()
        edges, edge_of, uses = np.unique(
            np.sort(half_edges, axis=1), axis=0, return_inverse=True, return_counts=True
        )
        edge_of = edge_of.reshape(-1)
        inner = uses == 2
        entries = _Entries()
        _add_edges(entries, edges, inner, edge_of, opposites, first=vertices)
        _add_vertices(entries, edges, inner, vertices)
        weights = entries.matrix((vertices + len(edges), vertices))
        ab, bc, ca = (vertices + edge_of.reshape(-1, 3)).T
        a, b, c = faces.T
        fine = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)
        return cls(weights, torch.from_numpy(fine.astype(np.int32)))

    def refine(self, vertices: Tensor) -> Tensor:
        """(V + E, C) float32 values of (V, C) float32 ones, on the CPU; the sums' order is fixed."""
        return torch.from_numpy(self.weights @ vertices.numpy())


def split_corners(corners: Tensor) -> Tensor:
    """(4 F, 3, C) values at the finer faces' corners of (F, 3, C) ones, linear within each face.

    That is what UV coordinates need at a seam.
    """
    a, b, c = corners.unbind(dim=1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return torch.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], dim=1).reshape(-1, 3, corners.shape[2])


class _Entries:
    """Entries of a sparse matrix, gathered piece by piece; those of one place add."""

    def __init__(self) -> None:
        self._pieces: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, rows: np.ndarray, columns: np.ndarray, values: float | np.ndarray) -> None:
        self._pieces.append((rows, columns, np.broadcast_to(np.asarray(values, np.float64), rows.shape)))

    def matrix(self, shape: tuple[int, int]) -> csr_array:
        rows, columns, values = (np.concatenate(part) for part in zip(*self._pieces, strict=True))
        return csr_array((values, (rows, columns)), shape=shape).astype(np.float32)


def _add_edges(
    entries: _Entries,
    edges: np.ndarray,
    inner: np.ndarray,
    edge_of: np.ndarray,
    opposites: np.ndarray,
    *,
    first: int,
) -> None:
    """Rows of the new vertices, which start at row ``first``: borders take the middle."""
    rows = first + np.arange(len(edges))
    for end in edges.T:
        entries.add(rows, end, np.where(inner, EDGE_ENDS, 0.5))
    faced = inner[edge_of]
    entries.add(first + edge_of[faced], opposites[faced], EDGE_OPPOSITES)


def _add_vertices(entries: _Entries, edges: np.ndarray, inner: np.ndarray, vertices: int) -> None:
    """Rows of the old vertices."""
    valence = np.bincount(edges.ravel(), minlength=vertices)
    borders = np.bincount(edges[~inner].ravel(), minlength=vertices)
    neighbour = np.where(valence == 3, 3.0 / 16.0, 3.0 / (8.0 * np.maximum(valence, 1)))
    own = np.where(borders == 0, 1.0 - valence * neighbour, np.where(borders == 2, BORDER_SELF, 1.0))
    entries.add(np.arange(vertices), np.arange(vertices), own)
    for vertex, other in (edges.T, edges.T[::-1]):
        smooth, along = borders[vertex] == 0, ~inner & (borders[vertex] == 2)
        entries.add(vertex[smooth], other[smooth], neighbour[vertex[smooth]])
        entries.add(vertex[along], other[along], BORDER_NEIGHBOUR)
