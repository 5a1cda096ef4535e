"""The iris network: five points of an iris, and sixteen of the lids about it."""

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


LIDS = 16
"""Points of the outline that lie on the lids: 0 the inner corner, 1 to 7 the lower lid, 8 the outer corner, 9
to 15 the upper lid, both lids from the inner corner on."""

_IRIS_MIRROR = [0, 3, 2, 1, 4]
_LIDS_MIRROR = [8, 7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10, 9]
"""Whose place each point takes where the network is shown an eye's mirror image."""


class EyeReading(NamedTuple):
    """What the network says of an eye.

    Attributes:
        iris: (5, 2) float64 pixels of the picture: the centre; the rim's outer, upper, inner and lower point.
        lids: (16, 2) float64 pixels, in the order of `LIDS`.
    """

    iris: np.ndarray
    lids: np.ndarray


def read_eye(network: Network, picture: np.ndarray, landmarks: np.ndarray, *, left: bool) -> EyeReading:
    """Read an eye where the mesh has it, and mirrored where that reading has it; the mean is taken.

    The network was made for left eyes: a right one is shown to it in a mirror, and the second time the other
    way round. The mesh has a closed eye too high: in a film of glasses the lids of one reading stay apart by
    0.15 of the eye's width in a blink, those of two by 0.1.

    Args:
        network: The iris network.
        picture: (H, W, 3) uint8.
        landmarks: (468, 2 or 3) of the face mesh, pixels.
        left: Whether it is the subject's left eye.
    """
    start, end = landmarks[list(EYE_CORNERS[0 if left else 1]), :2]
    once = _read(network, picture, _square(start, end, mirrored=not left))
    start, end = (once.lids[0], once.lids[8]) if left else (once.lids[8], once.lids[0])
    again = _read(network, picture, _square(start, end, mirrored=left))
    return EyeReading((once.iris + again.iris[_IRIS_MIRROR]) / 2, (once.lids + again.lids[_LIDS_MIRROR]) / 2)


def _square(start: np.ndarray, end: np.ndarray, *, mirrored: bool) -> Square:
    """The network's square about an eye between two corners, the one at smaller x first."""
    x, y = (start + end) / 2
    across = end - start
    side, roll = CROP * float(np.hypot(*across)), float(np.arctan2(across[1], across[0]))
    return Square(float(x), float(y), max(side, 1.0), roll, mirrored)


def _read(network: Network, picture: np.ndarray, square: Square) -> EyeReading:
    outputs = {len(out): out for out in network(cut(picture, square, network.size)).values()}
    iris, outline = (outputs[count].astype(np.float64).reshape(-1, 3)[:, :2] for count in (15, 213))
    return EyeReading(
        square.to_picture(iris / network.size), square.to_picture(outline[:LIDS] / network.size)
    )
