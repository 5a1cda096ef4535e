"""Tile bins: which Gaussians each 16 x 16 tile of the image blends, front to back.

Two stable 32-bit sorts: the N Gaussians by depth, then their I intersections with tiles by tile. Between the
two, a Gaussian's intersections are neighbours; the index there is called its slot, and carrying it through
the second sort lets the adjoint of blending write one gradient per intersection and sum each Gaussian's
without atomics.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.ellipse import half_extent, touches, visible_sigma
from samira_warp.kernels.raster.prefetch import AHEAD, prefetch_integers
from samira_warp.kernels.raster.projection import Projection
from samira_warp.kernels.runtime import launch_range, stream_of, warp_array
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors

GRAIN = 1024
"""Gaussians, or intersections, that are worth a thread."""

TILE = 16
"""Pixels along a tile's side: one AVX-512 register of float32 per row, and 256 GPU threads per tile."""

ENTRIES_MAX = 2**30
"""Intersections; sorting them wants twice the room, in 32-bit indices."""


class TileBins(NamedTuple):
    """Intersections of N Gaussians with T = columns x rows tiles (row-major): I entries.

    Attributes:
        tile_offsets: (T + 1,) int32; tile t blends entries tile_offsets[t] to tile_offsets[t + 1].
        records: (I,) int32, the record of each entry's Gaussian; sorted by tile, then depth, then input
            index.
        slots: (I,) int32, the slot of each entry: a permutation of 0..I-1.
        order: (N,) int32, the Gaussians by depth.
        slot_offsets: (N + 1,) int32; Gaussian order[k] owns slots slot_offsets[k] to slot_offsets[k + 1].
        record_offsets: (N + 1,) int32; Gaussian i has the record record_offsets[i] if record_offsets[i + 1]
            is one more, else it touches no tile and has none: records are numbered so that those in use lie
            side by side.
        columns: Tiles across the image.
        rows: Tiles down the image.
    """

    tile_offsets: Tensor
    records: Tensor
    slots: Tensor
    order: Tensor
    slot_offsets: Tensor
    record_offsets: Tensor
    columns: int
    rows: int

    @property
    def gaussians(self) -> Tensor:
        """(I,) int32, the index of each entry's Gaussian; entries that nothing fills name any."""
        return torch.searchsorted(self.record_offsets[1:], self.records, right=True, out_int32=True)


def bin_tiles(projection: Projection, *, width: int, height: int, capacity: int | None = None) -> TileBins:
    """Sort the Gaussians into the tiles that they can be seen in.

    That is where their alpha reaches ALPHA_MIN at some point between the tile's outermost pixel centres.

    Args:
        projection: N projected Gaussians.
        width: W, pixels.
        height: H, pixels.
        capacity: Room for this many intersections, so that their number need not be read back from the
            device, as in a captured graph it cannot be; where there are more, the farthest Gaussians lose
            theirs. None reads the number back and makes room for exactly as many.

    Raises:
        UserError: If a shape, dtype or device is wrong, or the image or the number of intersections is too
            large for the indices.
    """
    check_tensors(
        ("projection.means2d", projection.means2d, ("N", 2)),
        ("projection.depths", projection.depths, ("N",)),
        ("projection.conics", projection.conics, ("N", 3)),
        ("projection.opacities", projection.opacities, ("N",)),
        ("projection.visible", projection.visible, ("N",), torch.bool),
    )
    if capacity is not None and not (isinstance(capacity, int) and 0 <= capacity < ENTRIES_MAX):
        raise UserError(
            "capacity", expected=f"a whole number of at least 0 and less than {ENTRIES_MAX}", found=capacity
        )
    return bin_tiles_unchecked(projection, width=width, height=height, capacity=capacity)


@torch.no_grad()
def bin_tiles_unchecked(
    projection: Projection, *, width: int, height: int, capacity: int | None = None
) -> TileBins:
    """`bin_tiles`, of tensors and a capacity that were looked at."""
    columns, rows = tile_grid(width, height)
    if max(columns, rows) >= 2**15:
        raise UserError(
            "image", expected=f"fewer than {2**15 * TILE} pixels along each side", found=f"{width} x {height}"
        )
    seen = (projection.means2d, projection.conics, projection.opacities)
    ellipses = _Ellipses(*(values.contiguous() for values in seen))
    covers = _cover(projection, ellipses, width, height)
    count, order = len(covers.order), covers.order

    # where each Gaussian's slots and record begin: slots by depth, records by index
    slot_ends = _offsets(covers.counts.index_select(0, order))
    record_offsets = _offsets(covers.counts > 0).int()
    room = int(slot_ends[count]) if capacity is None else capacity
    if room >= ENTRIES_MAX:
        raise UserError(
            "Gaussians", expected=f"fewer than {ENTRIES_MAX} intersections with tiles", found=room
        )
    slot_offsets = slot_ends.clamp(max=room).int()

    # a row for each intersection; the sort wants twice the room
    tiles, slots = order.new_empty(2 * room), order.new_empty(2 * room)
    records_by_slot = order.new_empty(room)
    if capacity is not None:
        launch_range(_mark_unfilled, room, columns * rows, tiles, slots, records_by_slot, grain=GRAIN)
    offsets, entries = (slot_offsets, record_offsets), (tiles, slots, records_by_slot)
    launch_range(_emit_tiles, count, *covers, *ellipses, width, height, *offsets, *entries, grain=GRAIN)

    # stable: within a tile they stay in the order of depth
    _sort_pairs(tiles, slots, bits=(columns * rows).bit_length())
    records, tile_offsets = torch.empty_like(records_by_slot), order.new_empty(columns * rows + 1)
    launch_range(_close_lists, room + 1, columns * rows, *entries, records, tile_offsets, grain=GRAIN)
    # a copy, so that the sort's spare room is not kept
    return TileBins(
        tile_offsets, records, slots[:room].clone(), order, slot_offsets, record_offsets, columns, rows
    )


def tile_grid(width: int, height: int) -> tuple[int, int]:
    """Columns and rows of tiles of an image."""
    return -(-width // TILE), -(-height // TILE)


class _Ellipses(NamedTuple):
    """The part of N projected Gaussians that says where they are seen: as in `Projection`, contiguous."""

    means2d: Tensor
    conics: Tensor
    opacities: Tensor


class _Covers(NamedTuple):
    """The tiles of each Gaussian, and the Gaussians by depth.

    Attributes:
        order: (N,) int32, the Gaussians by depth, equal depths by index, those that touch no tile last.
        counts: (N,) int32, the number of tiles that the Gaussian touches.
        boxes: (N, 2) int64: the tiles left, top, right, bottom (the last two exclusive) that hold them, in 16
            bits each; and a bit for each tile of that box, row by row, where it has at most 64. Side by side,
            because they are read in the order of depth.
    """

    order: Tensor
    counts: Tensor
    boxes: Tensor


def _cover(projection: Projection, ellipses: _Ellipses, width: int, height: int) -> _Covers:
    """Find the tiles of each Gaussian, and sort by depth."""
    count = len(projection.depths)
    keys = projection.depths.new_empty(2 * count)
    order = torch.empty(2 * count, dtype=torch.int32, device=keys.device)
    counts, boxes = order.new_empty(count), order.new_empty(count, 2, dtype=torch.int64)
    seen = (projection.visible.contiguous(), projection.depths.contiguous())
    outputs = (counts, boxes, keys, order)
    launch_range(_cover_tiles, count, *seen, *ellipses, width, height, *outputs, grain=GRAIN)
    _sort_pairs(keys, order, bits=32)
    # a copy, so that the sort's spare room is not kept
    return _Covers(order[:count].clone(), counts, boxes)


def _sort_pairs(keys: Tensor, values: Tensor, *, bits: int) -> None:
    """Sort the first half of (2 N,) keys and values in place, stably; the other half is room to work in."""
    count = len(keys) // 2
    if count:
        with stream_of(keys.device):
            wp.utils.radix_sort_pairs(warp_array(keys), warp_array(values), count, end_bit=bits)


def _offsets(counts: Tensor) -> Tensor:
    """(N + 1,) int64, where each of N things of those sizes begins, and the sum."""
    offsets = torch.zeros(len(counts) + 1, dtype=torch.int64, device=counts.device)
    torch.cumsum(counts, dim=0, out=offsets[1:])
    return offsets


@wp.func
def _tile_box(mean: wp.vec2, extent: wp.vec2, width: wp.int32, height: wp.int32) -> wp.vec4i:
    """Tiles (left, top, right, bottom), the last two exclusive, that the box mean +- extent may reach."""
    last = wp.vec2(float(width - 1), float(height - 1))
    # indices of pixel centres, clamped as floats: the box of a huge Gaussian overflows an integer
    left = int(wp.clamp(wp.ceil(mean[0] - extent[0] - 0.5), 0.0, last[0]))
    top = int(wp.clamp(wp.ceil(mean[1] - extent[1] - 0.5), 0.0, last[1]))
    right = int(wp.clamp(wp.floor(mean[0] + extent[0] - 0.5), 0.0, last[0]))
    bottom = int(wp.clamp(wp.floor(mean[1] + extent[1] - 0.5), 0.0, last[1]))
    return wp.vec4i(left / TILE, top / TILE, right / TILE + 1, bottom / TILE + 1)


@wp.func
def _touches_tile(
    mean: wp.vec2,
    conic: wp.vec3,
    sigma: wp.float32,
    column: wp.int32,
    row: wp.int32,
    width: wp.int32,
    height: wp.int32,
) -> wp.bool:
    """Whether the ellipse meets the rectangle between the outermost pixel centres of a tile."""
    low = wp.vec2(float(column * TILE) + 0.5, float(row * TILE) + 0.5)
    high = wp.vec2(
        float(wp.min(column * TILE + TILE, width)) - 0.5, float(wp.min(row * TILE + TILE, height)) - 0.5
    )
    return touches(mean, conic, sigma, low, high)


@wp.func
def _pack_box(box: wp.vec4i) -> wp.int64:
    return (
        wp.int64(box[0])
        | wp.int64(box[1]) << wp.int64(16)
        | wp.int64(box[2]) << wp.int64(32)
        | wp.int64(box[3]) << wp.int64(48)
    )


@wp.func
def _unpack_box(packed: wp.int64) -> wp.vec4i:
    low, high = wp.int32(packed), wp.int32(packed >> wp.int64(32))
    return wp.vec4i(low & 0xFFFF, (low >> 16) & 0xFFFF, high & 0xFFFF, (high >> 16) & 0xFFFF)


@wp.kernel(enable_backward=False)
def _cover_tiles(
    first: wp.int32,
    visible: wp.array[wp.bool],
    depths: wp.array[wp.float32],
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    counts: wp.array[wp.int32],
    boxes: wp.array2d[wp.int64],
    keys: wp.array[wp.float32],
    order: wp.array[wp.int32],
) -> None:
    """Find each Gaussian's tiles, and its key for the sort by depth."""
    i = first + wp.tid()
    order[i] = i
    count = wp.int32(0)
    sigma = wp.float32(-1.0)
    if visible[i]:
        sigma = visible_sigma(opacities[i])
    if sigma >= 0.0:
        # only the tiles of its box can touch the ellipse; the answers are kept, a bit each, for `_emit_tiles`
        mean, conic = means2d[i], conics[i]
        box = _tile_box(mean, half_extent(conic, sigma), width, height)
        mask, bit = wp.int64(0), wp.int64(0)
        for row in range(box[1], box[3]):
            for column in range(box[0], box[2]):
                touched = wp.int64(_touches_tile(mean, conic, sigma, column, row, width, height))
                count += wp.int32(touched)
                # beyond 64 tiles the mask means nothing, but the shift has to stay defined
                mask = mask | touched << wp.min(bit, wp.int64(63))
                bit += wp.int64(1)
        boxes[i, 0] = _pack_box(box)
        boxes[i, 1] = mask
    counts[i] = count
    # those that are not seen go last
    keys[i] = wp.where(count > 0, depths[i], wp.float32(wp.inf))


@wp.kernel(enable_backward=False)
def _mark_unfilled(
    first: wp.int32,
    tile_count: wp.int32,
    tiles: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    records_by_slot: wp.array[wp.int32],
) -> None:
    """Room that may stay empty belongs to a tile after all others, which the sort leaves at the end."""
    slot = first + wp.tid()
    tiles[slot] = tile_count
    slots[slot] = slot
    records_by_slot[slot] = 0


@wp.kernel(enable_backward=False)
def _emit_tiles(
    first: wp.int32,
    order: wp.array[wp.int32],
    counts: wp.array[wp.int32],
    boxes: wp.array2d[wp.int64],
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    slot_offsets: wp.array[wp.int32],
    record_offsets: wp.array[wp.int32],
    tiles: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    records_by_slot: wp.array[wp.int32],
) -> None:
    """Write each Gaussian's tiles to its slots; those beyond the capacity are dropped."""
    rank = first + wp.tid()
    prefetch_integers(boxes, order[wp.min(rank + AHEAD, order.shape[0] - 1)])
    columns = (width + TILE - 1) / TILE
    slot, end = int(slot_offsets[rank]), slot_offsets[rank + 1]
    if slot == end:
        return
    i = order[rank]
    record = record_offsets[i]
    box, mask = _unpack_box(boxes[i, 0]), wp.int64(boxes[i, 1])
    # a bit for each tile, or, of boxes with more tiles than bits, the test again
    masked = (box[2] - box[0]) * (box[3] - box[1]) <= 64
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            touched = (mask & wp.int64(1)) != wp.int64(0)
            if not masked:
                touched = _touches_tile(
                    means2d[i], conics[i], visible_sigma(opacities[i]), column, row, width, height
                )
            if touched and slot < end:
                tiles[slot] = row * columns + column
                slots[slot] = slot
                records_by_slot[slot] = record
                slot += 1
            mask = mask >> wp.int64(1)


@wp.kernel(enable_backward=False)
def _close_lists(
    first: wp.int32,
    tile_count: wp.int32,
    tiles: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    records_by_slot: wp.array[wp.int32],
    records: wp.array[wp.int32],
    tile_offsets: wp.array[wp.int32],
) -> None:
    """Write the record of each sorted entry, and where lists of tiles begin between it and the one before."""
    entry = first + wp.tid()
    # beyond both ends lie tiles -1 and ``tile_count``, so that empty tiles there get their bounds too
    before, tile = wp.int32(-1), tile_count
    if entry > 0:
        before = tiles[entry - 1]
    if entry < records_by_slot.shape[0]:
        tile = tiles[entry]
        records[entry] = records_by_slot[slots[entry]]
    for t in range(before + 1, tile + 1):
        tile_offsets[t] = entry
