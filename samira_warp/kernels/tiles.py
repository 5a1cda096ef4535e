"""Tile bins: which Gaussians each 16 x 16 tile of the image blends, front to back.

Two stable 32-bit sorts: the N Gaussians by depth, then their I intersections with tiles by tile. Between the two, a Gaussian's
intersections are neighbours; the index there is called its slot, and carrying it through the second sort lets the adjoint of blending
write one gradient per intersection and sum each Gaussian's without atomics.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.errors import UserError
from samira_warp.kernels.ellipse import half_extent, touches, visible_sigma
from samira_warp.kernels.projection import GRAIN, Projection
from samira_warp.kernels.runtime import launch_range, stream_of, warp_array
from samira_warp.validation import check_tensor

TILE = 16
"""Pixels along a tile's side: one AVX-512 register of float32 per row, and 256 GPU threads per tile."""


class TileBins(NamedTuple):
    """Intersections of N Gaussians with T = columns x rows tiles (row-major); I entries, or as many as the capacity.

    Attributes:
        tile_offsets: (T + 1,) int32; tile t blends entries tile_offsets[t] to tile_offsets[t + 1].
        gaussians: (I,) int32, the Gaussian of each entry; sorted by tile, then depth, then input index.
        slots: (I,) int32, the slot of each entry: a permutation of 0..I-1.
        order: (N,) int32, the Gaussians by depth.
        slot_offsets: (N + 1,) int32; Gaussian order[k] owns slots slot_offsets[k] to slot_offsets[k + 1].
        columns: Tiles across the image.
        rows: Tiles down the image.
    """

    tile_offsets: Tensor
    gaussians: Tensor
    slots: Tensor
    order: Tensor
    slot_offsets: Tensor
    columns: int
    rows: int


@torch.no_grad()
def bin_tiles(projection: Projection, opacities: Tensor, *, width: int, height: int, capacity: int | None = None) -> TileBins:
    """Sort the Gaussians into the tiles where their alpha reaches ALPHA_MIN at some point between pixel centres.

    Args:
        projection: N projected Gaussians.
        opacities: (N,) float32 in 0..1.
        width: W, pixels.
        height: H, pixels.
        capacity: Room for this many intersections, so that their number need not be read back from the device; where there are more,
            the farthest Gaussians lose theirs. None reads the number back and makes room for exactly as many.

    Raises:
        UserError: If opacities do not fit, or the image or the intersections are too many for 32-bit indices.
    """
    count = projection.depths.shape[0]
    check_tensor("opacities", opacities, shape=(count,), device=projection.depths.device)
    columns, rows = -(-width // TILE), -(-height // TILE)
    geometry = (projection.means2d.contiguous(), projection.conics.contiguous(), opacities.contiguous(), width, height, columns)

    order = _depth_order(projection)
    counts = torch.zeros(count + 1, dtype=torch.int32, device=order.device)
    launch_range(_count_tiles, count, order, projection.visible, *geometry, counts, grain=GRAIN)
    slot_offsets = torch.zeros_like(counts)
    with stream_of(order.device):
        wp.utils.array_scan(warp_array(counts), warp_array(slot_offsets), inclusive=False)
    if capacity is None:
        capacity = int(counts.sum())
        if capacity >= 2**30:
            raise UserError("Gaussians", expected="fewer than 2^30 intersections with tiles", found=capacity)
    else:
        slot_offsets.clamp_(max=capacity)

    # the radix sort wants twice the room; tile number columns x rows marks entries that nothing fills
    tiles, slots = (torch.empty(2 * capacity, dtype=torch.int32, device=order.device) for _ in range(2))
    owners = torch.zeros(capacity, dtype=torch.int32, device=order.device)
    tiles[:capacity] = columns * rows
    torch.arange(capacity, dtype=torch.int32, out=slots[:capacity])
    launch_range(_emit_tiles, count, order, projection.visible, *geometry, slot_offsets, tiles, owners, grain=GRAIN)
    if capacity:
        with stream_of(order.device):
            wp.utils.radix_sort_pairs(warp_array(tiles), warp_array(slots), capacity, end_bit=(columns * rows).bit_length())
    slots = slots[:capacity]
    boundaries = torch.arange(columns * rows + 1, dtype=torch.int32, device=order.device)
    tile_offsets = torch.searchsorted(tiles[:capacity], boundaries, out_int32=True)
    return TileBins(tile_offsets, owners[slots], slots, order, slot_offsets, columns, rows)


def _depth_order(projection: Projection) -> Tensor:
    """(N,) int32 Gaussians by depth, equal depths by index, the invisible last."""
    count = projection.depths.shape[0]
    keys = torch.empty(2 * count, dtype=torch.float32, device=projection.depths.device)
    keys[:count] = torch.where(projection.visible, projection.depths, torch.inf)
    order = torch.empty(2 * count, dtype=torch.int32, device=keys.device)
    torch.arange(count, dtype=torch.int32, out=order[:count])
    if count:
        with stream_of(keys.device):
            wp.utils.radix_sort_pairs(warp_array(keys), warp_array(order), count)
    return order[:count]


@wp.func
def _tile_box(mean: wp.vec2, extent: wp.vec2, width: wp.int32, height: wp.int32) -> wp.vec4i:
    """Tiles (left, top, right, bottom), the last two exclusive, whose pixel centres the box mean +- extent may cover."""
    last = wp.vec2(float(width - 1), float(height - 1))
    # indices of pixel centres, clamped as floats: the box of a huge Gaussian overflows an integer
    left = int(wp.clamp(wp.ceil(mean[0] - extent[0] - 0.5), 0.0, last[0]))
    top = int(wp.clamp(wp.ceil(mean[1] - extent[1] - 0.5), 0.0, last[1]))
    right = int(wp.clamp(wp.floor(mean[0] + extent[0] - 0.5), 0.0, last[0]))
    bottom = int(wp.clamp(wp.floor(mean[1] + extent[1] - 0.5), 0.0, last[1]))
    return wp.vec4i(left / TILE, top / TILE, right / TILE + 1, bottom / TILE + 1)


@wp.func
def _touches_tile(
    mean: wp.vec2, conic: wp.vec3, sigma: wp.float32, column: wp.int32, row: wp.int32, width: wp.int32, height: wp.int32
) -> wp.bool:
    """Whether the ellipse meets the rectangle between the outermost pixel centres of a tile."""
    low = wp.vec2(float(column * TILE) + 0.5, float(row * TILE) + 0.5)
    high = wp.vec2(float(wp.min(column * TILE + TILE, width)) - 0.5, float(wp.min(row * TILE + TILE, height)) - 0.5)
    return touches(mean, conic, sigma, low, high)


@wp.kernel(enable_backward=False)
def _count_tiles(
    first: wp.int32,
    order: wp.array[wp.int32],
    visible: wp.array[wp.bool],
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    columns: wp.int32,
    counts: wp.array[wp.int32],
) -> None:
    rank = first + wp.tid()
    i = order[rank]
    sigma = visible_sigma(opacities[i])
    if not visible[i] or sigma < 0.0:
        return
    mean, conic = means2d[i], conics[i]
    box = _tile_box(mean, half_extent(conic, sigma), width, height)
    count = wp.int32(0)
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            if _touches_tile(mean, conic, sigma, column, row, width, height):
                count += 1
    counts[rank] = count


@wp.kernel(enable_backward=False)
def _emit_tiles(
    first: wp.int32,
    order: wp.array[wp.int32],
    visible: wp.array[wp.bool],
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    columns: wp.int32,
    slot_offsets: wp.array[wp.int32],
    tiles: wp.array[wp.int32],
    owners: wp.array[wp.int32],
) -> None:
    rank = first + wp.tid()
    slot, end = int(slot_offsets[rank]), slot_offsets[rank + 1]
    if slot == end:
        return
    i = order[rank]
    sigma = visible_sigma(opacities[i])
    mean, conic = means2d[i], conics[i]
    box = _tile_box(mean, half_extent(conic, sigma), width, height)
    # most ellipses touch every tile of their box: the count tells, and saves the second test
    all_touched = (box[2] - box[0]) * (box[3] - box[1]) == end - slot
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            if all_touched or (slot < end and _touches_tile(mean, conic, sigma, column, row, width, height)):
                tiles[slot] = row * columns + column
                owners[slot] = i
                slot += 1
