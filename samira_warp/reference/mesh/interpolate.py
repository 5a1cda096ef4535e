"""The interpolation of `samira_warp.kernels.mesh.interpolate` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.mesh_raster import MeshRaster
from samira_warp.kernels.mesh.topology import MeshTopology


def interpolate(attributes: Tensor, raster: MeshRaster, topology: MeshTopology) -> Tensor:
    """Attributes (V, C) or (B, V, C) in the pixels: (B, H, W, C), 0 where there is no triangle."""
    frames = len(raster.face)
    by_frame = attributes.expand(frames, *attributes.shape[-2:])
    seen = raster.face >= 0
    corners = topology.faces.long()[raster.face.long().clamp(min=0)]
    frame = torch.arange(frames, device=corners.device)[:, None, None, None]
    values = by_frame[frame, corners]
    image = (raster.barycentrics[..., None] * values).sum(dim=-2)
    return torch.where(seen[..., None], image, 0.0)
