"""Points drawn over pictures."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from samira_warp.io.images import resize_box

_FINE = 3
"""Dots are drawn on a grid so many times as fine, and averaged."""


def draw_dots(
    picture: np.ndarray, points: np.ndarray, color: tuple[int, int, int], *, radius: float
) -> np.ndarray:
    """A picture with dots on it.

    Args:
        picture: (H, W, 3) float32 display values.
        points: (L, 2) pixels of the dots' middles; those that are not finite are left out.
        color: Red, green and blue, 0 to 255.
        radius: Pixels from the middle of a dot to its edge.

    Returns:
        (H, W, 3) float32 display values.
    """
    height, width = picture.shape[:2]
    layer = Image.new("L", (_FINE * width, _FINE * height))
    draw = ImageDraw.Draw(layer)
    for x, y in points[np.isfinite(points).all(axis=1)].tolist():
        box = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse([_FINE * edge for edge in box], fill=255)
    covered = resize_box(np.asarray(layer, np.float32)[..., None] / 255.0, width=width, height=height)
    return picture * (1.0 - covered) + covered * (np.array(color, np.float32) / 255.0)
