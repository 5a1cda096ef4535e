"""The iris network: five points of an iris, and the outline of the eye about it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from samira_warp.vision.crops import Square, cut
from samira_warp.vision.runtime import Network

EYE_CORNERS = ((362, 263), (33, 133))
"""Points of the face mesh at the inner and outer corner of the subject's left eye, and at the outer and inner
corner of the right one: in both, the one at smaller x first."""

CROP = 2.3
"""Side of the network's square in widths of the eye; MediaPipe's own."""


class EyeReading(NamedTuple):
    """What the network says of an eye.

    Attributes:
        iris: (5, 2) float64 pixels of the picture: the centre, then four points of the rim.
        outline: (71, 2) float64 pixels: 16 points of the lids, then of the surroundings and the brow.
    """

    iris: np.ndarray
    outline: np.ndarray


def read_eye(network: Network, picture: np.ndarray, landmarks: np.ndarray, *, left: bool) -> EyeReading:
    """Run the network on an eye.

    It was made for left eyes: the right one is shown to it in a mirror.

    Args:
        network: The iris network.
        picture: (H, W, 3) uint8.
        landmarks: (468, 2 or 3) of the face mesh, pixels.
        left: Whether it is the subject's left eye.
    """
    start, end = landmarks[list(EYE_CORNERS[0 if left else 1]), :2]
    across = end - start
    roll = float(np.arctan2(across[1], across[0]))
    centre = (start + end) / 2
    side = CROP * float(np.hypot(*across))
    square = Square(float(centre[0]), float(centre[1]), side, roll, mirrored=not left)
    outputs = {len(out): out for out in network(cut(picture, square, network.size)).values()}
    iris, outline = (
        outputs[count].astype(np.float64).reshape(-1, 3)[:, :2] / network.size for count in (15, 213)
    )
    return EyeReading(square.to_picture(iris), square.to_picture(outline))
