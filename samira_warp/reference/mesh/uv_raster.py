"""The rasteriser of `samira_warp.kernels.mesh.uv_raster` in plain torch: every texel meets every face."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.uv_raster import UvRaster


def rasterize_uv(vt: Tensor, ft: Tensor, *, size: int) -> UvRaster:
    """Lowest face id that holds each texel's centre, and the centre's weights in it; O(F size) memory."""
    centres = (torch.arange(size, dtype=vt.dtype, device=vt.device) + 0.5) / size
    corners = vt[ft.long()]
    rows = [_row(torch.stack([centres, (1 - v).expand(size)], dim=1), corners) for v in centres]
    face, barycentrics = (torch.stack(parts) for parts in zip(*rows, strict=True))
    return UvRaster(face.to(torch.int32), barycentrics)


def _row(points: Tensor, corners: Tensor) -> tuple[Tensor, Tensor]:
    a, b, c = (corner[:, None] for corner in corners.unbind(dim=1))
    weights = torch.stack([_area(b, c, points), _area(c, a, points), _area(a, b, points)], dim=-1)
    area = weights.sum(dim=-1)
    inside = (area != 0) & (weights * area.sign()[..., None] >= 0).all(dim=-1)
    covered = inside.any(dim=0)
    face = inside.to(torch.uint8).argmax(dim=0)
    columns = torch.arange(len(points), device=points.device)
    barycentrics = weights[face, columns] / area[face, columns, None]
    return torch.where(covered, face, -1), torch.where(covered[:, None], barycentrics, 0)


def _area(a: Tensor, b: Tensor, p: Tensor) -> Tensor:
    """Twice the signed area of triangle (a, b, p)."""
    return (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        p[..., 0] - a[..., 0]
    )
