"""Which triangle covers each texel of a UV map, and where in the triangle the texel's centre lies."""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.gathering.grouping import Groups, group_by
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_ids, check_tensor

TILE = 16
"""Texels along a side of the square tiles that faces are binned into."""


class UvRaster(NamedTuple):
    """The covering triangle of every texel.

    Attributes:
        face: (H, W) int32 face id, -1 where no triangle covers the texel's centre.
        barycentrics: (H, W, 3) float32 weights of the triangle's corners, 0 where there is none.
    """

    face: Tensor
    barycentrics: Tensor


def rasterize_uv(vt: Tensor, ft: Tensor, *, size: int) -> UvRaster:
    """Rasterise UV triangles at texel centres, u = (column + 0.5) / W and v = 1 - (row + 0.5) / H.

    Mirrored triangles count like any other; where several cover a texel the lowest face id wins. Triangles
    that share an edge leave no gap along it: both evaluate it from the same end.

    Args:
        vt: (T, 2) float32 UV coordinates, u to the right and v up; what lies outside [0, 1] is cut off.
        ft: (F, 3) integer corners, on the same device.
        size: H = W, texels.

    Raises:
        UserError: A tensor has another shape, dtype or device, or an id is out of range.
    """
    check_tensor("vt", vt, shape=("T", 2))
    check_ids("ft", ft, shape=("F", 3), count=vt.shape[0], device=vt.device)
    texels = torch.stack([vt[:, 0] * size, (1 - vt[:, 1]) * size], dim=1)
    ft = ft.to(torch.int32).contiguous()
    face = torch.full((size, size), -1, dtype=torch.int32, device=vt.device)
    barycentrics = torch.zeros(size, size, 3, device=vt.device)
    tiles = _bin_faces(texels[ft.long()], size)
    launch_range(_rasterize, size * size, texels, ft, *tiles, face, barycentrics, grain=TILE * TILE)
    return UvRaster(face, barycentrics)


def _bin_faces(corners: Tensor, size: int) -> Groups:
    """For each tile, row by row, the faces whose bounding box touches it, in the order of their ids."""
    across = -(-size // TILE)
    # the tiles that each face's box spans
    low = (corners.amin(dim=1) / TILE).floor().long().clamp(min=0)
    high = (corners.amax(dim=1) / TILE).floor().long().clamp(max=across - 1)
    extent = (high - low + 1).clamp(min=0)
    counts = extent.prod(dim=1)
    # one entry per face and tile: the n-th entry of a face is the n-th tile of its box
    face = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    place = torch.arange(len(face), device=face.device) - (counts.cumsum(0) - counts)[face]
    column = low[face, 0] + place % extent[face, 0]
    row = low[face, 1] + place // extent[face, 0]
    tiles = group_by(row * across + column, across * across)
    return Groups(tiles.offsets, face.to(torch.int32)[tiles.members.long()])


@wp.func
def _edge(start: wp.int32, end: wp.int32, texels: wp.array[wp.vec2], p: wp.vec2) -> wp.float32:
    """Twice the signed area of (start, end, p): the same bits, but for the sign, from either end."""
    low = wp.min(start, end)
    a = texels[low]
    b = texels[wp.max(start, end)]
    area = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    if low != start:
        area = -area
    return area


@wp.kernel(enable_backward=False)
def _rasterize(
    first: wp.int32,
    texels: wp.array[wp.vec2],
    ft: wp.array2d[wp.int32],
    tile_offsets: wp.array[wp.int32],
    tile_faces: wp.array[wp.int32],
    face: wp.array2d[wp.int32],
    barycentrics: wp.array2d[wp.vec3],
) -> None:
    """One texel: the first face of its tile's list that holds its centre."""
    index = first + wp.tid()
    width = face.shape[1]
    row = index // width
    column = index - row * width
    p = wp.vec2(wp.float32(column) + 0.5, wp.float32(row) + 0.5)
    tile = (row // TILE) * ((width + TILE - 1) // TILE) + column // TILE
    for entry in range(tile_offsets[tile], tile_offsets[tile + 1]):
        candidate = tile_faces[entry]
        a = ft[candidate, 0]
        b = ft[candidate, 1]
        c = ft[candidate, 2]
        weights = wp.vec3(_edge(b, c, texels, p), _edge(c, a, texels, p), _edge(a, b, texels, p))
        area = weights[0] + weights[1] + weights[2]
        if area != 0.0 and wp.min(wp.sign(area) * weights) >= 0.0:
            face[row, column] = candidate
            barycentrics[row, column] = weights / area
            break
