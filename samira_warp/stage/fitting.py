"""Pictures of several shapes where one is needed: laid in the middle of white."""

from __future__ import annotations

import numpy as np

from samira_warp.io.images import resize_box, to_uint8


def centred(picture: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """(height, width, 3) float32 display values: a picture (H, W, 3), no larger, in the middle of white."""
    top, left = (height - picture.shape[0]) // 2, (width - picture.shape[1]) // 2
    canvas = np.ones((height, width, 3), np.float32)
    canvas[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return canvas


def fitted(picture: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: a picture (H, W, 3) in the middle of white, made smaller where it has to be.

    Nothing is cut off, stretched or enlarged.
    """
    scale = min(width / picture.shape[1], height / picture.shape[0], 1.0)
    smaller = resize_box(
        picture.astype(np.float32) / 255.0,
        width=max(round(picture.shape[1] * scale), 1),
        height=max(round(picture.shape[0] * scale), 1),
    )
    return to_uint8(centred(smaller, width=width, height=height))
