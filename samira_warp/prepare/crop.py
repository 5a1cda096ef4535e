"""The square of a video that is kept: one for all frames, so that the camera stays one.

The head is found in mattes, which tracking needs anyway: what stands above the narrowest place between head
and shoulders.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from samira_warp.support.errors import UserError

NECK_WIDTH = 0.85
"""Below the first row that is narrower than this share of the widest one above, the neck begins; cheeks and
hair vary less."""

ROOM = 1.5
"""Side of the crop in sizes of the head: all of the neck, some of the shoulders, and room to move between the
frames looked at."""

OUTLIERS = 0.04
"""Share of heads at each end that do not count: a hand before the face, a matte that failed."""


class Crop(NamedTuple):
    """A square of a picture.

    Attributes:
        x: Its left edge, pixels.
        y: Its upper edge, pixels.
        side: Pixels.
    """

    x: int
    y: int
    side: int

    def of(self, picture: np.ndarray) -> np.ndarray:
        """The part (side, side, ...) of (H, W, ...)."""
        return picture[self.y : self.y + self.side, self.x : self.x + self.side]


class Box(NamedTuple):
    """Pixels from left and top to just before right and bottom."""

    left: int
    top: int
    right: int
    bottom: int


def find_head(matte: np.ndarray) -> Box | None:
    """The head in one matte.

    It ends where the largest covered piece is narrowest between the head and what grows wider than the head
    again, or at its lower end where nothing does. Under long hair there is no such place: then it is the
    whole piece.

    Args:
        matte: (H, W) coverage in 0..1.

    Returns:
        Its box, or None where nothing is covered.
    """
    pieces, count = ndimage.label(matte > 0.5)
    if count == 0:
        return None
    sizes = np.bincount(pieces.ravel())
    person = pieces == 1 + np.argmax(sizes[1:])
    rows = np.flatnonzero(person.any(axis=1))
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    widths = person[top:bottom].sum(axis=1)
    widest = np.maximum.accumulate(widths)
    narrow = np.flatnonzero(widths < NECK_WIDTH * widest)
    if len(narrow):
        shoulders = np.flatnonzero(widths[narrow[0] :] > widest[narrow[0]])
        end = narrow[0] + shoulders[0] if len(shoulders) else len(widths)
        bottom = top + int(narrow[0] + np.argmin(widths[narrow[0] : end])) + 1
    columns = np.flatnonzero(person[top:bottom].any(axis=0))
    return Box(int(columns[0]), top, int(columns[-1]) + 1, bottom)


def crop_around(heads: Iterable[Box], *, width: int, height: int) -> Crop | None:
    """The square within a picture around heads wherever they went, or None where there are none."""
    boxes = np.array(list(heads), dtype=np.float64).reshape(-1, 4)
    if len(boxes) == 0:
        return None
    left, top = np.quantile(boxes[:, :2], OUTLIERS, axis=0)
    right, bottom = np.quantile(boxes[:, 2:], 1.0 - OUTLIERS, axis=0)
    side = min(round(ROOM * max(right - left, bottom - top)), width, height)
    x, y = (
        min(max(round(0.5 * (low + high - side)), 0), size - side)
        for low, high, size in ((left, right, width), (top, bottom, height))
    )
    return Crop(x, y, side)


def middle(*, width: int, height: int) -> Crop:
    """The largest square in a picture's middle."""
    side = min(width, height)
    return Crop((width - side) // 2, (height - side) // 2, side)


def parse_crop(text: str, *, width: int, height: int) -> Crop:
    """Read X,Y,SIDE, a square of whole pixels within a picture.

    Raises:
        UserError: It is not of that form, or reaches beyond the picture.
    """
    try:
        x, y, side = (int(part) for part in text.split(","))
    except ValueError:
        raise UserError("--crop", expected="X,Y,SIDE, three whole numbers", found=repr(text)) from None
    if min(x, y) < 0 or side < 1 or x + side > width or y + side > height:
        raise UserError(
            "--crop", expected=f"a square within the video's {width} x {height} pixels", found=text
        )
    return Crop(x, y, side)
