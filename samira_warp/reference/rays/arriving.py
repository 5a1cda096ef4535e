"""What arrives of a light past a mesh, in plain torch: the twin of `kernels.rays.arriving`."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.rays.arriving import Irradiance

WORD = 32


def flags(bits: Tensor) -> Tensor:
    """(M, D) bool of (M, D / 32) int32: which directions are open."""
    places = torch.arange(WORD, dtype=torch.int32, device=bits.device)
    return (bits[..., None].bitwise_right_shift(places).bitwise_and(1) == 1).flatten(1)


def arriving_irradiance(bits: Tensor, normals: Tensor, directions: Tensor, powers: Tensor) -> Irradiance:
    """See `kernels.rays.arriving.arriving_irradiance`; any floating dtype."""
    cosines = (normals @ directions.T).clamp(min=0.0)
    return Irradiance((cosines * flags(bits)) @ powers, cosines @ powers)


def open_shares(bits: Tensor, axes: Tensor, edges: Tensor, directions: Tensor, areas: Tensor) -> Tensor:
    """See `kernels.rays.arriving.open_shares`; any floating dtype."""
    above = (axes @ directions.T - edges[:, None, None]).clamp(min=0.0)
    weights = above.square() * areas
    whole = weights.sum(dim=-1)
    share = (weights * flags(bits)).sum(dim=-1) / torch.where(whole > 0.0, whole, 1.0)
    return torch.where(whole > 0.0, share, 1.0).T
