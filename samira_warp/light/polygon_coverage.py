"""How much of every texel of a cubemap a polygon covers, as it is seen from the cube's centre.

On a face's plane, texels are squares and a polygon in space is a polygon: what both share is exact geometry.
The area F(x, y) of the polygon beyond no corner (x, y), left of it and above it, is half the sum of the cross
products of the polygon's edges about that corner, each edge cut to that quadrant: what closes the cut polygon
lies on lines through the corner and adds nothing. A square's share is a difference of four F.
"""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import FACES, face_axes

_SIDES = ((1.0, 0.0, 1.0), (-1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (0.0, -1.0, 1.0))
"""Inward normals of the four planes through the centre and a face's edges, in the face's own axes."""


def polygon_coverage(outline: Tensor, *, size: int) -> Tensor:
    """(6, size, size) float64 share of each texel, 0 to 1, that a convex polygon covers.

    Args:
        outline: (N, 3) float64 corners in order, either way round, in a plane that does not pass through the
            origin.
        size: S, texels along a face's edge.
    """
    axes = face_axes().to(outline.dtype)
    coverage = outline.new_zeros(FACES, size, size)
    for face in range(FACES):
        seen = outline @ axes[face].T
        for side in _SIDES:
            seen = _cut(seen, seen @ seen.new_tensor(side))
        if len(seen) > 2:
            coverage[face] = _square_shares((seen[:, :2] / seen[:, 2:] + 1.0) * (0.5 * size), size)
    return coverage


def _cut(corners: Tensor, heights: Tensor) -> Tensor:
    """The part (M, 3) of a convex polygon (N, 3) that is above 0, from the heights (N,) of its corners."""
    kept = []
    for index, here in enumerate(corners):
        there, low, high = corners[index - 1], heights[index - 1], heights[index]
        if (low > 0.0) != (high > 0.0):
            kept.append(there + low / (low - high) * (here - there))
        if high > 0.0:
            kept.append(here)
    return torch.stack(kept) if kept else corners[:0]


def _square_shares(corners: Tensor, size: int) -> Tensor:
    """(S, S) share of the unit squares of [0, S]^2, by row and column, in a convex polygon (M, 2)."""
    shares = corners.new_zeros(size, size)
    low = corners.amin(dim=0).floor().clamp(0, size)
    high = corners.amax(dim=0).ceil().clamp(0, size)
    (left, top), (right, bottom) = low.int().tolist(), high.int().tolist()
    if left < right and top < bottom:
        area = _area_up_to(corners, torch.arange(left, right + 1), torch.arange(top, bottom + 1)).abs()
        inside = area[1:, 1:] - area[1:, :-1] - area[:-1, 1:] + area[:-1, :-1]
        shares[top:bottom, left:right] = inside.clamp(0.0, 1.0)
    return shares


def _area_up_to(corners: Tensor, columns: Tensor, rows: Tensor) -> Tensor:
    """(R, C) signed area of the part of a polygon (M, 2) left of each column and above each row."""
    total = corners.new_zeros(len(rows), len(columns))
    for here, there in zip(corners, corners.roll(-1, dims=0), strict=True):
        step = there - here
        first, last = _inside(here[0] - columns, step[0]), _inside(here[1] - rows, step[1])
        enter = torch.maximum(first[0], last[0][:, None])
        leave = torch.minimum(first[1], last[1][:, None])
        # the cross product of the cut edge's ends about the corner
        across = (here[0] - columns) * step[1] - (here[1] - rows)[:, None] * step[0]
        total += 0.5 * across * (leave - enter).clamp(min=0.0)
    return total


def _inside(start: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
    """Where along 0 to 1 ``start + share * step`` is below 0: from, and to; empty where it nowhere is."""
    if step == 0.0:
        return torch.zeros_like(start), torch.where(start < 0.0, 1.0, 0.0).to(start)
    crossing = (-start / step).clamp(0.0, 1.0)
    if step > 0.0:
        return torch.zeros_like(crossing), crossing
    return crossing, torch.ones_like(crossing)
