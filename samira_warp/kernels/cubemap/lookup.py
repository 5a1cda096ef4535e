"""Seamless lookups in cubemaps and chains of cubemap mips, differentiable in texels, directions and levels.

A lookup reads the cell of four texel centres around its direction; cells reach over the edges of a face
(`texel_at`), so the result is continuous everywhere. The adjoint to the texels is a gather in two steps:
lookups are sorted by cell, each cell sums its own lookups in their order, and each texel sums the cells it is
a corner of. No atomics: the same bits every time, for any number of threads.
"""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.cubemap.layout import (
    FACES,
    Footprint,
    bilinear_weights,
    cell_count,
    cell_index,
    cell_texels,
    check_cubemap,
    face_point,
    find_face,
    find_face_adjoint,
    footprint,
    mip_table,
    neighbour_face,
    point_s,
    point_t,
    spread_corner,
)
from samira_warp.kernels.runtime import launch_range, stream_of, warp_array
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor, check_tensors

GRAIN = 4096
"""Lookups that are worth a thread."""


def sample_cubemap(cubemap: Tensor, directions: Tensor) -> Tensor:
    """Look a cubemap up, bilinearly and seamlessly.

    Where three faces meet, the texel that isn't there is the mean of the three that are.

    Args:
        cubemap: (6, S, S, C) float32.
        directions: (M, 3) float32, of any length; a zero direction sees 0 and gets no gradient.

    Returns:
        (M, C) float32; differentiable in ``cubemap`` and, within a cell, in ``directions``.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_cubemap("cubemap", cubemap)
    check_tensor("directions", directions, shape=("M", 3), device=cubemap.device)
    levels = directions.new_zeros(directions.shape[0])
    return _SampleMips.apply(cubemap.reshape(-1, cubemap.shape[-1]), directions, levels, (cubemap.shape[1],))


def sample_mips(mips: tuple[Tensor, ...], directions: Tensor, levels: Tensor) -> Tensor:
    """Look a chain of cubemaps up: bilinearly in each of the two nearest levels, linearly between them.

    Args:
        mips: L cubemaps (6, S_l, S_l, C) float32, of any sizes.
        directions: (M, 3) float32, of any length; a zero direction sees 0 and gets no gradient.
        levels: (M,) float32, clamped to [0, L - 1]. The gradient at a whole level is that of the interval
            above it (at L - 1, below it); outside the range it is 0.

    Returns:
        (M, C) float32; differentiable in ``mips``, ``levels`` and, within a cell, in ``directions``.

    Raises:
        UserError: No mips, or a wrong shape, dtype or device.
    """
    if not mips:
        raise UserError("mips", expected="at least one cubemap", found="none")
    check_cubemap("mips[0]", mips[0])
    channels, device = mips[0].shape[-1], mips[0].device
    for level, mip in enumerate(mips):
        check_cubemap(f"mips[{level}]", mip, channels=channels, device=device)
    check_tensors(("directions", directions, ("M", 3)), ("levels", levels, ("M",)), device=device)
    return _SampleMips.apply(pack_mips(mips), directions, levels, tuple(mip.shape[1] for mip in mips))


def pack_mips(mips: tuple[Tensor, ...]) -> Tensor:
    """(T, C) all texels of all mips, one after the other: what the kernels read."""
    return torch.cat([mip.reshape(-1, mip.shape[-1]) for mip in mips])


def texel_gradient(cells: Tensor, places: Tensor, grad_lookups: Tensor, sizes: tuple[int, ...]) -> Tensor:
    """Adjoint of bilinear lookups with respect to the texels of a packed chain of mips.

    Args:
        cells: (K, R) int32 cell of each lookup, counted over the chain (`mip_table`); the count of cells for
            a lookup to leave out.
        places: (K, R, 3) float32: x and y within the cell, and the lookup's weight.
        grad_lookups: (K, C) float32 gradients of the sums of the R weighted lookups.
        sizes: S of each mip.

    Returns:
        (T, C) float32.
    """
    channels, device = grad_lookups.shape[1], grad_lookups.device
    texels = sum(FACES * size * size for size in sizes)
    count = sum(FACES * (size + 1) ** 2 for size in sizes)

    # lookups by cell, stably: each cell's stay in their order
    keys, order, lookups = _to_sort(cells.view(-1), count)
    with stream_of(device):
        wp.utils.radix_sort_pairs(warp_array(keys), warp_array(order), lookups, end_bit=count.bit_length())
    starts = torch.empty(count + 1, dtype=torch.int32, device=device)
    launch_range(_find_starts, lookups + 1, keys, lookups, count, starts, grain=GRAIN)

    # each cell sums what goes to its four corners
    sums = torch.empty(count, channels, 4, dtype=torch.float32, device=device)
    table, slots = mip_table(sizes, device), cells.shape[1]
    inputs = (starts, order, places.view(-1, 3), grad_lookups, table, slots)
    launch_range(_sum_cells, count * channels, *inputs, sums, grain=GRAIN)

    # each texel sums the cells that it is a corner of
    grad_texels = torch.empty(texels, channels, dtype=torch.float32, device=device)
    launch_range(_gather_texels, texels * channels, sums, table, grad_texels, grain=GRAIN)
    return grad_texels


def _to_sort(cells: Tensor, count: int) -> tuple[Tensor, Tensor, int]:
    """Keys and values of the lookups to sort by cell, and their number.

    Both are int32, with as much room again behind them for the sort. On a CPU those to leave out, most of an
    image's background, stay out of the sort; a GPU would have to wait for their number.
    """
    if cells.device.type == "cpu":
        kept = torch.nonzero(cells < count)[:, 0].to(torch.int32)
        cells = cells[kept]
    else:
        kept = torch.arange(cells.shape[0], dtype=torch.int32, device=cells.device)
    room = torch.empty(2, 2 * kept.shape[0], dtype=torch.int32, device=cells.device)
    room[0, : kept.shape[0]], room[1, : kept.shape[0]] = cells, kept
    return room[0], room[1], kept.shape[0]


class _SampleMips(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, texels: Tensor, directions: Tensor, levels: Tensor, sizes: tuple[int, ...]
    ) -> Tensor:
        texels, directions, levels = texels.contiguous(), directions.contiguous(), levels.contiguous()
        count, table = directions.shape[0], mip_table(sizes, texels.device)
        result = texels.new_empty(count, texels.shape[1])
        launch_range(_sample, count, texels, directions, levels, table, result, grain=GRAIN)
        ctx.save_for_backward(texels, directions, levels)
        ctx.sizes = sizes
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_result: Tensor) -> tuple[Tensor | None, ...]:
        texels, directions, levels = ctx.saved_tensors
        wants_texels, *_ = ctx.needs_input_grad
        grad_result, table = grad_result.contiguous(), mip_table(ctx.sizes, grad_result.device)
        count, slots = directions.shape[0], min(2, len(ctx.sizes))

        # to directions and levels lookup by lookup, which leaves behind where it read
        grad_directions, grad_levels = torch.empty_like(directions), torch.empty_like(levels)
        cells = torch.empty(count, slots, dtype=torch.int32, device=texels.device)
        places = torch.empty(count, slots, 3, dtype=torch.float32, device=texels.device)
        inputs = (texels, directions, levels, table, grad_result)
        outputs = (grad_directions, grad_levels, cells, places)
        launch_range(_sample_adjoint, count, *inputs, *outputs, grain=GRAIN)

        # to the texels, which many lookups share, by gathering
        grad_texels = texel_gradient(cells, places, grad_result, ctx.sizes) if wants_texels else None
        return grad_texels, grad_directions, grad_levels, None


@wp.func
def lower_level(level: wp.float32, levels: wp.int32) -> tuple[wp.int32, wp.float32]:
    """The first of the two levels to blend, and the weight of the second."""
    clamped = wp.clamp(level, 0.0, wp.float32(levels - 1))
    first = wp.clamp(wp.int32(wp.floor(clamped)), 0, wp.max(levels - 2, 0))
    return first, clamped - wp.float32(first)


@wp.func
def level_moves(level: wp.float32, levels: wp.int32) -> wp.bool:
    """Whether the result changes with the level: inside the range, its ends included."""
    return levels > 1 and level >= 0.0 and level <= wp.float32(levels - 1)


@wp.func
def _weigh(
    texels: wp.array2d[wp.float32], first: wp.int32, taps: wp.vec4i, weights: wp.vec4, channel: wp.int32
) -> wp.float32:
    """Weighted sum of a cell's texels, the missing one left out."""
    result = wp.float32(0.0)
    for k in range(4):
        if taps[k] >= 0:
            result += weights[k] * texels[first + taps[k], channel]
    return result


@wp.kernel(enable_backward=False)
def _sample(
    first: wp.int32,
    texels: wp.array2d[wp.float32],
    directions: wp.array[wp.vec3],
    levels: wp.array[wp.float32],
    table: wp.array2d[wp.int32],
    result: wp.array2d[wp.float32],
) -> None:
    m = first + wp.tid()
    direction = directions[m]
    channels = texels.shape[1]
    for c in range(channels):
        result[m, c] = 0.0
    if wp.length_sq(direction) == 0.0:
        return
    point = find_face(direction)
    lower, fraction = lower_level(levels[m], table.shape[0])
    for slot in range(2):
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        if share > 0.0:
            level = lower + slot
            cell = footprint(point, table[level, 0])
            taps = cell_texels(cell, table[level, 0])
            weights = share * spread_corner(bilinear_weights(cell), taps)
            for c in range(channels):
                result[m, c] += _weigh(texels, table[level, 1], taps, weights, c)


@wp.kernel(enable_backward=False)
def _sample_adjoint(
    first: wp.int32,
    texels: wp.array2d[wp.float32],
    directions: wp.array[wp.vec3],
    levels: wp.array[wp.float32],
    table: wp.array2d[wp.int32],
    grad_result: wp.array2d[wp.float32],
    grad_directions: wp.array[wp.vec3],
    grad_levels: wp.array[wp.float32],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    m = first + wp.tid()
    direction = directions[m]
    count = table.shape[0]
    grad_s = wp.float32(0.0)
    grad_t = wp.float32(0.0)
    grad_level = wp.float32(0.0)
    point = find_face(direction)
    # the lookup again, in both levels
    lower, fraction = lower_level(levels[m], count)
    seen = wp.length_sq(direction) > 0.0
    for slot in range(wp.min(count, 2)):
        level = lower + slot
        size = table[level, 0]
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        cell = footprint(point, size)
        # where it read, for the texels; what reads nothing counts as in the cell after the last
        cells[m, slot] = table[level, 2] + cell_index(cell, size)
        places[m, slot] = wp.vec3(cell.x, cell.y, share)
        if not seen or share == 0.0:
            cells[m, slot] = table[count - 1, 2] + cell_count(table[count - 1, 0])
        # the slopes of the bilinear weights by x and y are weights, too
        taps = cell_texels(cell, size)
        weights = spread_corner(bilinear_weights(cell), taps)
        along_x = spread_corner(wp.vec4(cell.y - 1.0, 1.0 - cell.y, -cell.y, cell.y), taps)
        along_y = spread_corner(wp.vec4(cell.x - 1.0, -cell.x, 1.0 - cell.x, cell.x), taps)
        # s and t span 2 over the face's size, and a level step trades one mip for the other
        scale = 0.5 * wp.float32(size) * share
        sign = wp.where(slot == 0, -1.0, 1.0)
        for c in range(texels.shape[1]):
            grad_s += scale * grad_result[m, c] * _weigh(texels, table[level, 1], taps, along_x, c)
            grad_t += scale * grad_result[m, c] * _weigh(texels, table[level, 1], taps, along_y, c)
            grad_level += sign * grad_result[m, c] * _weigh(texels, table[level, 1], taps, weights, c)
    if seen:
        grad_directions[m] = find_face_adjoint(direction, point, grad_s, grad_t)
    else:
        grad_directions[m] = wp.vec3()
    grad_levels[m] = wp.where(seen and level_moves(levels[m], count), grad_level, 0.0)


@wp.kernel(enable_backward=False)
def _find_starts(
    first: wp.int32, keys: wp.array[wp.int32], lookups: wp.int32, count: wp.int32, starts: wp.array[wp.int32]
) -> None:
    """Cell g's lookups are those from starts[g] to starts[g + 1] in sorted order."""
    i = first + wp.tid()
    before = wp.int32(-1)
    here = count
    if i > 0:
        before = keys[i - 1]
    if i < lookups:
        here = keys[i]
    for g in range(before + 1, wp.min(here, count) + 1):
        starts[g] = i


@wp.kernel(enable_backward=False)
def _sum_cells(
    first: wp.int32,
    starts: wp.array[wp.int32],
    order: wp.array[wp.int32],
    places: wp.array[wp.vec3],
    grad_lookups: wp.array2d[wp.float32],
    table: wp.array2d[wp.int32],
    slots: wp.int32,
    sums: wp.array2d[wp.vec4],
) -> None:
    """What a cell's lookups owe to each of its four texels, the missing one's share handed to the others."""
    index = first + wp.tid()
    g = index // grad_lookups.shape[1]
    c = index % grad_lookups.shape[1]
    total = wp.vec4()
    for i in range(starts[g], starts[g + 1]):
        lookup = order[i]
        place = places[lookup]
        cell = Footprint()
        cell.x = place[0]
        cell.y = place[1]
        total += place[2] * grad_lookups[lookup // slots, c] * bilinear_weights(cell)
    if starts[g] < starts[g + 1]:
        # a cell at a cube's corner gives the missing texel's share to the three others: find which cell g is
        level = wp.int32(0)
        while level + 1 < table.shape[0] and table[level + 1, 2] <= g:
            level += 1
        size = table[level, 0]
        within = g - table[level, 2]
        cell = Footprint()
        cell.face = within // ((size + 1) * (size + 1))
        cell.row = (within // (size + 1)) % (size + 1) - 1
        cell.column = within % (size + 1) - 1
        total = spread_corner(total, cell_texels(cell, size))
    sums[g, c] = total


@wp.func
def _collect(
    sums: wp.array2d[wp.vec4],
    first: wp.int32,
    face: wp.int32,
    column: wp.int32,
    row: wp.int32,
    size: wp.int32,
    c: wp.int32,
) -> wp.float32:
    """Sum of a texel's shares over the cells of one face; the texel may lie one step over the face's edge."""
    total = wp.float32(0.0)
    for k in range(4):
        i = column - k % 2
        j = row - k // 2
        if i >= -1 and i < size and j >= -1 and j < size:
            total += sums[first + (face * (size + 1) + j + 1) * (size + 1) + i + 1, c][k]
    return total


@wp.kernel(enable_backward=False)
def _gather_texels(
    first: wp.int32,
    sums: wp.array2d[wp.vec4],
    table: wp.array2d[wp.int32],
    grad_texels: wp.array2d[wp.float32],
) -> None:
    """A texel collects from its own face's cells, and from neighbours' for which it is just over the edge."""
    index = first + wp.tid()
    texel = index // grad_texels.shape[1]
    c = index % grad_texels.shape[1]
    level = wp.int32(0)
    while level + 1 < table.shape[0] and table[level + 1, 1] <= texel:
        level += 1
    size = table[level, 0]
    within = texel - table[level, 1]
    face = within // (size * size)
    row = (within // size) % size
    column = within % size
    total = _collect(sums, table[level, 2], face, column, row, size, c)
    for edge in range(4):
        ds = wp.where(edge == 0, -1, wp.where(edge == 1, 1, 0))
        dt = wp.where(edge == 2, -1, wp.where(edge == 3, 1, 0))
        at_edge = (
            (ds < 0 and column == 0)
            or (ds > 0 and column == size - 1)
            or (dt < 0 and row == 0)
            or (dt > 0 and row == size - 1)
        )
        if at_edge:
            # seen from the neighbour, the texel centre (t, S - 1 deep) lies unfolded at S + 1, one step over
            # the common edge
            other = neighbour_face(face, ds, dt)
            s = wp.where(ds == 0, 2 * column + 1 - size, ds * size)
            t = wp.where(dt == 0, 2 * row + 1 - size, dt * size)
            point = face_point(face, s, t, size + 1)
            over_column = (point_s(other, point) + size + 1) // 2 - 1
            over_row = (point_t(other, point) + size + 1) // 2 - 1
            total += _collect(sums, table[level, 2], other, over_column, over_row, size, c)
    grad_texels[texel, c] = total
