"""Rendered layers on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.io.images import to_uint8, write_exr, write_png
from samira_warp.stage.layers import LayerImage


def write_layer(folder: Path, name: str, layer: LayerImage) -> np.ndarray:
    """Write a layer's PNG, and its EXR where it has values; the picture comes back as (H, W, 3) uint8."""
    picture = display_values(layer)
    write_png(folder / f"{name}.png", picture)
    if layer.values is not None:
        write_exr(folder / f"{name}.exr", layer.values.cpu().numpy())
    return to_uint8(picture)


def display_values(layer: LayerImage) -> np.ndarray:
    """(H, W, 3) display values of a layer in 0..1."""
    picture = layer.picture.clamp(0.0, 1.0).cpu().numpy()
    return np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture
