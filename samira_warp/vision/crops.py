"""Squares cut out of a picture, turned and at another size; and points of them, put back into the picture.

Coordinates are continuous throughout: x to the right, y down, (0, 0) the upper left corner of the upper left
pixel, whose centre is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from PIL import Image


@dataclass(frozen=True)
class Square:
    """A square in a picture.

    Attributes:
        x: Of its centre, pixels.
        y: Of its centre, pixels.
        side: Pixels.
        roll: Radians that its own x axis is turned from the picture's, towards y (clockwise as one sees it).
        mirrored: Whether its own x axis points the other way.
    """

    x: float
    y: float
    side: float
    roll: float = 0.0
    mirrored: bool = False

    def axes(self) -> np.ndarray:
        """(2, 2) float64: its sides along its own x and y, in columns, pixels of the picture."""
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        return turn * (self.side * np.array([-1.0 if self.mirrored else 1.0, 1.0]))

    def to_picture(self, points: np.ndarray) -> np.ndarray:
        """Put points (..., 2), in shares of the square from its own upper left corner, into the picture."""
        return (points - 0.5) @ self.axes().T + np.array([self.x, self.y])

    def from_picture(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `to_picture`."""
        return (points - np.array([self.x, self.y])) @ np.linalg.inv(self.axes()).T + 0.5

    def enlarged(self, factor: float) -> Square:
        """One about the same centre."""
        return replace(self, side=self.side * factor)


def cut(
    picture: np.ndarray, square: Square, size: int, *, outside: Literal["border", "black"] = "border"
) -> np.ndarray:
    """Resample a square of a picture at another size.

    Where it shrinks, pixels are first averaged over boxes of as many whole pixels as come nearest, so that a
    step of the bilinear samples is one and a half of the averages at most.

    Args:
        picture: (H, W, 3) or (H, W) uint8.
        square: Where.
        size: Pixels of either side of the result.
        outside: What is seen beyond the picture: its border, which goes on, or black.

    Returns:
        (size, size[, 3]) uint8.
    """
    region, left, top = _region(picture, square, padded=outside == "border")
    box = max(round(square.side / size), 1)
    image = Image.fromarray(region)
    if box > 1:
        image = image.reduce(box)
    axes = square.axes() / (size * box)
    corner = (square.to_picture(np.zeros(2)) - np.array([left, top])) / box
    rows = (*axes[0], corner[0], *axes[1], corner[1])
    image = image.transform((size, size), Image.Transform.AFFINE, rows, resample=Image.Resampling.BILINEAR)
    return np.asarray(image)


def _region(picture: np.ndarray, square: Square, *, padded: bool) -> tuple[np.ndarray, int, int]:
    """The part of a picture that a square needs, and its place."""
    corners = square.to_picture(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    margin = 2 + int(square.side / 16)
    left, top = (int(value) for value in np.floor(corners.min(axis=0)) - margin)
    right, bottom = (int(value) for value in np.ceil(corners.max(axis=0)) + margin)
    height, width = picture.shape[:2]
    x0, x1 = min(max(left, 0), width - 1), max(min(right, width), 1)
    y0, y1 = min(max(top, 0), height - 1), max(min(bottom, height), 1)
    part = picture[y0:y1, x0:x1]
    if not padded:
        return np.ascontiguousarray(part), x0, y0
    beyond = [(y0 - top, bottom - y1), (x0 - left, right - x1), (0, 0)]
    pads = [(max(before, 0), max(after, 0)) for before, after in beyond[: picture.ndim]]
    return np.pad(part, pads, mode="edge"), min(left, x0), min(top, y0)
