"""Triangles in blocks of eight under an 8-ary tree of boxes, for the CPU's vector instructions."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

WIDTH = 8
"""Triangles of a leaf, and children of a node."""


class BlockTree:
    """A tree without pointers: child c of node i is node, or leaf, ``8 i + c`` of the level below.

    The triangles are put into an order in which each 8 in a row lie together, and each 64, and so on: a leaf
    is 8 triangles, and all nodes but the last of a level are full.

    Attributes:
        corners: (L, 9, 8) float32, the three corners of each leaf's triangles, coordinate by coordinate. What
            the last leaf has too many are points.
        boxes: (K, 6, 8) float32, the lower and upper bounds of each node's children, level by level. What the
            last node of a level has too many are bounded by infinities that no test passes.
        levels: (H,) int32, the first node of each level, the one above the leaves first.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        """Build the tree over at least one triangle, on the CPU.

        Args:
            vertices: (V, 3) float32.
            faces: (F, 3) int32 vertex ids.
        """
        centres = vertices.numpy()[faces.numpy()].mean(axis=1)
        order = _order(centres)
        spare = -len(order) % WIDTH
        corners = faces[torch.from_numpy(order)].long()
        # a point: the last triangle's first corner
        corners = torch.cat([corners, corners[-1:, :1].expand(spare, 3)])
        self._corners = corners.view(-1, WIDTH, 3).transpose(1, 2).contiguous()
        self.corners = vertices.new_empty(len(self._corners), 9, WIDTH)
        counts = [-(-len(self.corners) // WIDTH)]
        while counts[-1] > 1:
            counts.append(-(-counts[-1] // WIDTH))
        self.levels = torch.tensor(np.concatenate([[0], np.cumsum(counts)[:-1]]), dtype=torch.int32)
        self.boxes = vertices.new_empty(sum(counts), 6, WIDTH)
        self.refit(vertices)

    def refit(self, vertices: Tensor) -> None:
        """Move the vertices."""
        placed = vertices.index_select(0, self._corners.flatten()).view(-1, 3, WIDTH, 3)
        self.corners.view(-1, 3, 3, WIDTH).copy_(placed.transpose(2, 3))
        coordinates = self.corners.view(-1, 3, 3 * WIDTH) if False else self.corners.view(-1, 3, 3, WIDTH)
        lower, upper = coordinates.amin(dim=(1, 3)), coordinates.amax(dim=(1, 3))
        for first in self.levels.tolist():
            count = -(-len(lower) // WIDTH)
            nodes = self.boxes[first : first + count]
            lower, upper = _pad(lower, torch.inf), _pad(upper, -torch.inf)
            nodes[:, :3].copy_(lower.view(count, WIDTH, 3).transpose(1, 2))
            nodes[:, 3:].copy_(upper.view(count, WIDTH, 3).transpose(1, 2))
            lower, upper = nodes[:, :3].amin(dim=2), nodes[:, 3:].amax(dim=2)


def _pad(bounds: Tensor, value: float) -> Tensor:
    spare = -len(bounds) % WIDTH
    return torch.cat([bounds, bounds.new_full((spare, 3), value)]) if spare else bounds


def _order(centres: np.ndarray) -> np.ndarray:
    """Triangles' numbers in the tree's order: halved again and again across the longer side."""
    order = np.arange(len(centres))
    todo = [(0, len(order))]
    while todo:
        begin, end = todo.pop()
        leaves = -(-(end - begin) // WIDTH)
        if leaves <= 1:
            continue
        # the largest full subtree with less, and how many of those one half has
        full = 1
        while full * WIDTH < leaves:
            full *= WIDTH
        middle = begin + (-(-leaves // full) + 1) // 2 * full * WIDTH
        part = order[begin:end]
        extent = np.ptp(centres[part], axis=0)
        ranks = np.argsort(centres[part, np.argmax(extent)], kind="stable")
        order[begin:end] = part[ranks]
        todo += [(begin, middle), (middle, end)]
    return order
