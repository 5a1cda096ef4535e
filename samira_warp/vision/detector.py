"""The face detector: boxes and six points of every face in a picture (BlazeFace, short range)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from samira_warp.vision.crops import Square, cut
from samira_warp.vision.runtime import Network

SCORE = 0.5
"""Of what is taken for a face, after the sigmoid; MediaPipe's own."""

OVERLAP = 0.3
"""Boxes whose intersection is a larger share of their union are one face's; MediaPipe's own."""

_GRIDS = ((16, 2), (8, 6))
"""The network's grids of anchors: cells along either side, and anchors in each cell."""


@dataclass(frozen=True)
class Detection:
    """A face as the detector sees it.

    Attributes:
        score: 0..1.
        box: (4,) float64 left, top, right, bottom, pixels of the picture.
        points: (6, 2) float64 pixels: right eye, left eye (the subject's), nose, mouth, right ear, left ear.
    """

    score: float
    box: np.ndarray
    points: np.ndarray

    @property
    def size(self) -> float:
        """The longer side of its box, pixels."""
        return float(max(self.box[2] - self.box[0], self.box[3] - self.box[1]))

    @property
    def roll(self) -> float:
        """Radians from the picture's x axis to the line from the right eye to the left one."""
        across = self.points[1] - self.points[0]
        return float(np.arctan2(across[1], across[0]))


def detect_faces(network: Network, picture: np.ndarray) -> list[Detection]:
    """Faces of a picture, the best first.

    The network looks at 128 x 128 pixels and finds faces that are a tenth of them and more. Where it finds
    none in the whole picture, it looks at parts of it: squares of its shorter side, then of half of that.

    Args:
        network: The detector.
        picture: (H, W, 3) uint8.
    """
    height, width = picture.shape[:2]
    for side in (max(height, width), min(height, width), min(height, width) / 2):
        found = [
            face
            for y in _centres(height, side)
            for x in _centres(width, side)
            for face in _detect(network, picture, Square(x, y, side))
        ]
        if found:
            return _merge(found)
    return []


def _centres(length: int, side: float) -> list[float]:
    """Centres of squares that cover a length and overlap by a third or more."""
    if side >= length:
        return [length / 2]
    count = int(np.ceil((length - side) / (side * 2 / 3))) + 1
    return [*np.linspace(side / 2, length - side / 2, count)]


def _anchors() -> np.ndarray:
    """(896, 2) float64 centres of the anchors, in shares of the picture."""
    centres = []
    for cells, each in _GRIDS:
        y, x = np.mgrid[:cells, :cells]
        centres.append(np.repeat((np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5) / cells, each, axis=0))
    return np.concatenate(centres)


_ANCHORS = _anchors()


def _detect(network: Network, picture: np.ndarray, square: Square) -> list[Detection]:
    outputs = network(cut(picture, square, network.size, outside="black"))
    scores = 1.0 / (1.0 + np.exp(-np.clip(outputs["classificators"][:, 0].astype(np.float64), -100, 100)))
    chosen = np.flatnonzero(scores > SCORE)
    raw = outputs["regressors"][chosen].astype(np.float64).reshape(-1, 8, 2) / network.size
    raw[:, 0] += _ANCHORS[chosen]
    raw[:, 2:] += _ANCHORS[chosen, None]
    found = []
    for score, values in zip(scores[chosen], raw, strict=True):
        centre, half = square.to_picture(values[0]), values[1] * square.side / 2
        box = np.concatenate([centre - half, centre + half])
        found.append(Detection(float(score), box, square.to_picture(values[2:])))
    return _merge(found)


def _merge(found: list[Detection]) -> list[Detection]:
    """Non-maximum suppression whose survivors are the means of what they suppress, weighted by the scores."""
    left = sorted(found, key=lambda face: -face.score)
    merged = []
    while left:
        same = [face for face in left if face is left[0] or _overlap(face.box, left[0].box) > OVERLAP]
        left = [face for face in left if not any(face is other for other in same)]
        weights = np.array([face.score for face in same])
        weights /= weights.sum()
        box = np.tensordot(weights, np.stack([face.box for face in same]), axes=1)
        points = np.tensordot(weights, np.stack([face.points for face in same]), axes=1)
        merged.append(Detection(same[0].score, box, points))
    return merged


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union."""
    extent = np.clip(np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2]), 0.0, None)
    shared = float(extent.prod())
    union = float((one[2:] - one[:2]).prod() + (other[2:] - other[:2]).prod()) - shared
    return shared / union if union > 0 else 0.0
