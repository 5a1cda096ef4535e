"""EXIF's eight orientations: cameras store what they see and how they were held.

The number says which sides of the picture are the first row and the first column that are stored: 1 top and
left, 2 top and right, 3 bottom and right, 4 bottom and left; 5 to 8 the same with rows and columns exchanged.
"""

from __future__ import annotations

import numpy as np

LYING = (5, 6, 7, 8)
"""Orientations of pictures whose rows are stored as columns."""

_BACK = {6: 8, 8: 6}
"""Quarter turns are undone by each other, all others by themselves."""


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels (h, w, ...) as they are shown, (H, W, ...): a view."""
    if orientation in LYING:
        pixels = pixels.swapaxes(0, 1)
    # which of the eight mirror left and right, and top and bottom, once rows are rows
    x, y = orientation in (2, 3, 6, 7), orientation in (3, 4, 7, 8)
    return pixels[:: -1 if y else 1, :: -1 if x else 1]


def as_stored(picture: np.ndarray, orientation: int) -> np.ndarray:
    """A picture (H, W, ...) as its pixels are stored, (h, w, ...): a view, to write them into."""
    return upright(picture, _BACK.get(orientation, orientation))
