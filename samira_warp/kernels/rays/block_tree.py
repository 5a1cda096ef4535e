"""Triangles in blocks of eight under an 8-ary tree of boxes, for the CPU's vector instructions."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime import launch_range

WIDTH = 8
"""Triangles of a leaf, and children of a node."""

GRAIN = 64
"""Nodes that are worth a thread."""

RELATIVE, ABSOLUTE = 1.00001, 5e-7
"""What balls are larger by, for rounding: of their radius in every test that is made of them, and of their
distance from the origin in the differences of coordinates there, some eight roundings of 2^-24."""


class BlockTree:
    """A tree without pointers: child c of node i is node, or leaf, ``8 i + c`` of the level below.

    The triangles are put into an order in which each 8 in a row lie together, and each 64, and so on: a leaf
    is 8 triangles, and all nodes but the last of a level are full. A refit moves bounds, never the order.

    Attributes:
        corners: (L, 9, 8) float32, of each leaf's triangles the x, y and z of the first corners, the second
            and the third. What the last leaf has too many are points.
        boxes: (K, 7, 8) float32, of each node's children the lower bounds, the upper bounds and the radius of
            a ball about the box's centre that holds the child; level by level. What the last node of a level
            has too many is bounded by infinities that pass no test.
        levels: (H,) int32, the first node of each level, the one above the leaves first, the root last.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        """Build the tree over at least one triangle, on the CPU.

        Args:
            vertices: (V, 3) float32.
            faces: (F, 3) int32 vertex ids.
        """
        order = _order(vertices.numpy()[faces.numpy()].mean(axis=1))
        ids = faces[torch.from_numpy(order)]
        # too many: points, at the last triangle's first corner
        self._ids = torch.cat([ids, ids[-1:, :1].expand(-len(ids) % WIDTH, 3)]).contiguous()
        leaves = len(self._ids) // WIDTH
        counts = [-(-leaves // WIDTH)]
        while counts[-1] > 1:
            counts.append(-(-counts[-1] // WIDTH))
        self._counts = [leaves, *counts]
        self._firsts = [0, *np.cumsum(counts)[:-1].tolist()]
        self.levels = torch.tensor(self._firsts, dtype=torch.int32)
        self.corners = vertices.new_empty(leaves, 9, WIDTH)
        self.boxes = vertices.new_zeros(sum(counts), 7, WIDTH)
        self.boxes[:, :3] = torch.inf
        self.boxes[:, 3:6] = -torch.inf
        self.refit(vertices)

    def refit(self, vertices: Tensor) -> None:
        """Move the vertices."""
        inputs = (vertices, self._ids, self.corners, self.boxes)
        launch_range(_fit_leaf, self._counts[0], *inputs, grain=GRAIN)
        for count, first, parents in zip(self._counts[1:], self._firsts, self._firsts[1:], strict=False):
            launch_range(_fit_node, count, first, parents, self.boxes, grain=GRAIN)


@wp.func
def _write_bounds(
    boxes: wp.array3d[wp.float32],
    node: wp.int32,
    child: wp.int32,
    lower: wp.vec3,
    upper: wp.vec3,
    radius: wp.float32,
) -> None:
    """The bounds of one child, the ball a little larger than it is, for the rounding of all that uses it."""
    distance = wp.max(wp.max(-lower), wp.max(upper))
    for axis in range(3):
        boxes[node, axis, child] = lower[axis]
        boxes[node, 3 + axis, child] = upper[axis]
    boxes[node, 6, child] = RELATIVE * radius + ABSOLUTE * distance


@wp.kernel(enable_backward=False)
def _fit_leaf(
    first: wp.int32,
    vertices: wp.array[wp.vec3],
    ids: wp.array2d[wp.int32],
    corners: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
) -> None:
    """The corners of one leaf's triangles, and its bounds, which its parent has."""
    leaf = first + wp.tid()
    lower = vertices[ids[WIDTH * leaf, 0]]
    upper = lower
    for triangle in range(WIDTH):
        for corner in range(3):
            vertex = vertices[ids[WIDTH * leaf + triangle, corner]]
            lower = wp.min(lower, vertex)
            upper = wp.max(upper, vertex)
            for axis in range(3):
                corners[leaf, 3 * corner + axis, triangle] = vertex[axis]
    centre, farthest = 0.5 * (lower + upper), wp.float32(0.0)
    for triangle in range(WIDTH):
        for corner in range(3):
            vertex = vertices[ids[WIDTH * leaf + triangle, corner]]
            farthest = wp.max(farthest, wp.length_sq(vertex - centre))
    _write_bounds(boxes, leaf / WIDTH, leaf % WIDTH, lower, upper, wp.sqrt(farthest))


@wp.kernel(enable_backward=False)
def _fit_node(first: wp.int32, level: wp.int32, parents: wp.int32, boxes: wp.array3d[wp.float32]) -> None:
    """The bounds of one node of the level that begins at ``level``, which its parent has."""
    node = first + wp.tid()
    lower, upper = wp.vec3(wp.inf), wp.vec3(-wp.inf)
    for child in range(WIDTH):
        for axis in range(3):
            lower[axis] = wp.min(lower[axis], boxes[level + node, axis, child])
            upper[axis] = wp.max(upper[axis], boxes[level + node, 3 + axis, child])
    centre, farthest = 0.5 * (lower + upper), wp.float32(0.0)
    for child in range(WIDTH):
        low, high = wp.vec3(0.0), wp.vec3(0.0)
        for axis in range(3):
            low[axis] = boxes[level + node, axis, child]
            high[axis] = boxes[level + node, 3 + axis, child]
        if low[0] <= high[0]:
            reach = wp.length(0.5 * (low + high) - centre) + boxes[level + node, 6, child]
            farthest = wp.max(farthest, reach)
    farthest = wp.min(farthest, 0.5 * wp.length(upper - lower))
    _write_bounds(boxes, parents + node / WIDTH, node % WIDTH, lower, upper, farthest)


def _order(centres: np.ndarray) -> np.ndarray:
    """Numbers of triangles with (F, 3) centres, in the tree's order.

    They are divided again and again across their longest side, each time so that the first part makes full
    subtrees.
    """
    order = np.arange(len(centres))
    todo = [(0, len(order))]
    while todo:
        begin, end = todo.pop()
        leaves = -(-(end - begin) // WIDTH)
        if leaves <= 1:
            continue
        # leaves of the largest full subtree that holds less than these
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
