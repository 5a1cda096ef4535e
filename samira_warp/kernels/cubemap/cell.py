"""Reading coloured cubemaps inside a kernel: a cell's texels, their blend, its slope, trilinear lookups.

`kernels.cubemap.lookup` does the same for any number of channels, as an operator of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from samira_warp.kernels.cubemap.layout import FacePoint, Footprint, bilinear_weights, cell_texels, footprint
from samira_warp.kernels.cubemap.lookup import lower_level

if TYPE_CHECKING:
    Quad = Any
else:
    Quad = wp.types.matrix(shape=(4, 3), dtype=wp.float32)
    """The texels of a cell, one a row."""


@wp.func
def read_cell(texels: wp.array[wp.vec3], first: wp.int32, cell: Footprint, size: wp.int32) -> Quad:
    """A cell's texels; where three faces meet, the missing one is the mean of the others."""
    result = Quad()

    # most cells lie within a face, where nothing has to be looked for
    if cell.column >= 0 and cell.row >= 0 and cell.column < size - 1 and cell.row < size - 1:
        corner = first + (cell.face * size + cell.row) * size + cell.column
        result[0] = texels[corner]
        result[1] = texels[corner + 1]
        result[2] = texels[corner + size]
        result[3] = texels[corner + size + 1]
        return result

    taps = cell_texels(cell, size)
    total = wp.vec3()
    for k in range(4):
        if taps[k] >= 0:
            result[k] = texels[first + taps[k]]
            total += result[k]
    for k in range(4):
        if taps[k] < 0:
            result[k] = total / 3.0
    return result


@wp.func
def blend_cell(cell: Footprint, texels: Quad) -> wp.vec3:
    """The bilinear value."""
    weights = bilinear_weights(cell)
    return weights[0] * texels[0] + weights[1] * texels[1] + weights[2] * texels[2] + weights[3] * texels[3]


@wp.func
def cell_slope(cell: Footprint, texels: Quad, grad_value: wp.vec3) -> wp.vec2:
    """Gradient with respect to the place in the cell, along x and y, from that of the bilinear value."""
    a = wp.dot(texels[0], grad_value)
    b = wp.dot(texels[1], grad_value)
    c = wp.dot(texels[2], grad_value)
    d = wp.dot(texels[3], grad_value)
    return wp.vec2((b - a) * (1.0 - cell.y) + (d - c) * cell.y, (c - a) * (1.0 - cell.x) + (d - b) * cell.x)


@wp.func
def look_up(
    mips: wp.array[wp.vec3], table: wp.array2d[wp.int32], point: FacePoint, level: wp.float32
) -> wp.vec3:
    """Trilinear lookup in a packed chain of mips."""
    lower, fraction = lower_level(level, table.shape[0])
    result = wp.vec3()
    for slot in range(2):
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        if share > 0.0:
            size = table[lower + slot, 0]
            cell = footprint(point, size)
            result += share * blend_cell(cell, read_cell(mips, table[lower + slot, 1], cell, size))
    return result
