"""Fourier mapping Gamma of UV position and displacement maps (Eq. uv_geom_feat)."""

from __future__ import annotations

import torch
from torch import Tensor


def fourier_features(values: Tensor, *, bands: int) -> Tensor:
    """Append sines and cosines of octave-spaced frequencies to a map.

    Args:
        values: (B, D, H, W) map, about [-1, 1].
        bands: Number of octaves; frequencies are pi 2^k for k = 0 .. bands - 1.

    Returns:
        (B, D (1 + 2 bands), H, W): the input itself, then all sines, then all cosines, band by band.
    """
    frequencies = torch.pi * 2.0 ** torch.arange(bands, dtype=values.dtype, device=values.device)
    phases = (frequencies[:, None, None, None, None] * values).transpose(0, 1).flatten(1, 2)
    return torch.cat([values, torch.sin(phases), torch.cos(phases)], dim=1)


def fourier_channels(dimensions: int, *, bands: int) -> int:
    """Number of channels that `fourier_features` makes of ``dimensions``."""
    return dimensions * (1 + 2 * bands)
