"""The rasteriser of `samira_warp.kernels.mesh.mesh_raster` in plain torch: all meets all."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.mesh_raster import MeshRaster
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.support.constants import NEAR_PLANE


def rasterize_mesh(points: Tensor, topology: MeshTopology, *, width: int, height: int) -> MeshRaster:
    """Nearest triangle of each pixel and its weights there; O(F W) memory. The boxes are whole images."""
    rasters = [[_row(frame[topology.faces.long()], row, width) for row in range(height)] for frame in points]
    faces = torch.stack([torch.stack([face for face, _ in rows]) for rows in rasters])
    barycentrics = torch.stack([torch.stack([weights for _, weights in rows]) for rows in rasters])
    boxes = faces.new_tensor([0, 0, width, height]).expand(len(points), len(topology.faces), 4)
    return MeshRaster(faces.to(torch.int32), barycentrics, boxes.to(torch.int32))


def _row(corners: Tensor, row: int, width: int) -> tuple[Tensor, Tensor]:
    """(W,) face and (W, 3) barycentrics of a row of pixels, of (F, 3, 3) corners."""
    x = torch.arange(width, dtype=corners.dtype, device=corners.device) + 0.5
    p = torch.stack([x, torch.full_like(x, row + 0.5)], dim=1)
    a, b, c = (corner[:, None, :2] for corner in corners.unbind(dim=1))
    weights = torch.stack([_double_area(b, c, p), _double_area(c, a, p), _double_area(a, b, p)], dim=-1)
    inside = ((weights >= 0).all(dim=-1) | (weights <= 0).all(dim=-1)) & (weights.sum(dim=-1) != 0)
    drawn = (corners[:, :, 2] > NEAR_PLANE).all(dim=1)
    over_depth = weights / corners[:, None, :, 2]
    depth = torch.where(
        inside & drawn[:, None], (weights.sum(dim=-1) / over_depth.sum(dim=-1)).detach(), torch.inf
    )
    face = depth.argmin(dim=0)
    chosen = over_depth[face, torch.arange(width, device=corners.device)]
    covered = depth.amin(dim=0).isfinite()
    # what is not taken has no gradient, not even of 0 / 0
    chosen = torch.where(covered[:, None], chosen, 1.0)
    barycentrics = torch.where(covered[:, None], chosen / chosen.sum(dim=-1, keepdim=True), 0.0)
    return torch.where(covered, face, -1), barycentrics


def _double_area(a: Tensor, b: Tensor, p: Tensor) -> Tensor:
    """Twice the signed area of triangle (a, b, p)."""
    return (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        p[..., 0] - a[..., 0]
    )
