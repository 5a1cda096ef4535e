"""The bins of `samira_warp.kernels.raster.tiles` in plain torch: their specification."""

from __future__ import annotations

import torch

from samira_warp.kernels.raster.projection import Projection
from samira_warp.kernels.raster.tiles import TILE, TileBins
from samira_warp.reference.raster.projection import least_sigma
from samira_warp.support.constants import ALPHA_MIN


def bin_tiles(projection: Projection, *, width: int, height: int) -> TileBins:
    """As `samira_warp.kernels.raster.tiles.bin_tiles` without a capacity.

    Every Gaussian meets every tile: O(N T) memory.
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    row, column = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    left, top = TILE * column.flatten(), TILE * row.flatten()
    right, bottom = (left + TILE).clamp(max=width), (top + TILE).clamp(max=height)
    edges = [left + 0.5, top + 0.5, right - 0.5, bottom - 0.5]
    rectangles = torch.stack(edges, dim=-1).to(projection.means2d)

    depths = torch.where(projection.visible, projection.depths, torch.inf)
    order = torch.argsort(depths, stable=True)
    least = least_sigma(projection.means2d[order, None], projection.conics[order, None], rectangles[None])
    cut = torch.log(projection.opacities / ALPHA_MIN)
    touched = projection.visible[order, None] & (least <= cut[order, None])

    ranks, tiles = touched.nonzero(as_tuple=True)
    slots = torch.argsort(tiles, stable=True)
    offsets = torch.searchsorted(
        tiles[slots], torch.arange(columns * rows + 1, device=tiles.device), out_int32=True
    )
    slot_offsets = torch.cat([touched.new_zeros(1, dtype=torch.long), touched.sum(dim=1).cumsum(dim=0)])
    listed = touched.any(dim=1)[torch.argsort(order)]
    record_offsets = torch.cat([touched.new_zeros(1, dtype=torch.long), listed.cumsum(dim=0)])
    records = record_offsets[order[ranks][slots]]
    return TileBins(
        tile_offsets=offsets,
        records=records.int(),
        slots=slots.int(),
        order=order.int(),
        slot_offsets=slot_offsets.int(),
        record_offsets=record_offsets.int(),
        columns=columns,
        rows=rows,
    )
