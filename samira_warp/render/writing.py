"""Rendered layers on disk."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import get_args

import numpy as np

from samira_warp.io.images import to_uint8, write_exr, write_png
from samira_warp.stage.layer_names import Layer
from samira_warp.stage.layers import LayerImage


def write_layer(folder: Path, name: str, layer: LayerImage) -> np.ndarray:
    """Write a layer's PNG, and its EXR where it has values; the picture comes back as uint8.

    Args:
        folder: Where to.
        name: Stem of the files.
        layer: What to write.

    Returns:
        (H, W, 3), or (H, W, 4) of one with alpha.
    """
    picture = display_values(layer)
    write_png(folder / f"{name}.png", picture)
    if layer.values is not None:
        write_exr(folder / f"{name}.exr", layer.values.cpu().numpy())
    return to_uint8(picture)


def display_values(layer: LayerImage) -> np.ndarray:
    """(H, W, 3) display values of a layer in 0..1, (H, W, 4) of one with alpha."""
    picture = layer.picture.clamp(0.0, 1.0).cpu().numpy()
    return np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture


def left_over(out: Path, names: Collection[str], *, layers: Collection[Layer], films: bool) -> list[Path]:
    """Pictures and films of an earlier rendering into a folder that another one would leave as they are.

    Args:
        out: The output folder, which need not be there.
        names: Names of the pictures that are about to be written, without their suffix.
        layers: The layers of which they are.
        films: Whether a film of each layer is written as well.

    Returns:
        Paths, sorted. Files that no rendering writes are not among them.
    """
    found = []
    for layer in get_args(Layer):
        written = set(names) if layer in layers else set()
        pictures = [path for suffix in ("png", "exr") for path in (out / layer).glob(f"*.{suffix}")]
        found += [path for path in pictures if path.stem not in written]
        film = out / f"{layer}.mp4"
        if film.exists() and not (films and layer in layers):
            found.append(film)
    return sorted(found)
