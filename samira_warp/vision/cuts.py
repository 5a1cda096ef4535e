"""Where a film changes to another shot, and the longest part without such a change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

LEVELS = 4
CELLS = LEVELS**3
"""Of each colour in a histogram, and of all three."""

SAMPLE = 32
"""Pixels of either side that a picture is shrunk to before its colours are counted."""

COLOUR_JUMP = 0.25
"""Share of a picture's colours that a cut changes at least, by half the sum of absolute differences.

From one picture of the three clips to the next it is below 0.05; between two of them, above 0.6."""

LANDMARK_JUMP = 0.15
"""Of the face's size: how far its points move at a cut at least, on average. A head that is shaken does 0.1
at 25 pictures a second."""


def colour_histogram(picture: np.ndarray) -> np.ndarray:
    """(64,) float32 shares of a picture's colours, which sum to one.

    Each of a shrunken picture's pixels is shared between the cells next to it, so that light that changes a
    little changes a histogram a little.

    Args:
        picture: (H, W, 3) uint8.
    """
    step = max(min(picture.shape[:2]) // SAMPLE, 1)
    small = np.asarray(
        Image.fromarray(np.ascontiguousarray(picture[::step, ::step])).resize((SAMPLE, SAMPLE))
    )
    place = small.reshape(-1, 3).astype(np.float32) * ((LEVELS - 1) / 255.0)
    low = np.minimum(place.astype(np.int64), LEVELS - 2)
    high = place - low
    counts = np.zeros(CELLS)
    for corner in np.ndindex(2, 2, 2):
        cell = (low + corner) @ [LEVELS**2, LEVELS, 1]
        weight = np.where(corner, high, 1.0 - high).prod(axis=1)
        counts += np.bincount(cell, weight, CELLS)
    return (counts / counts.sum()).astype(np.float32)


def find_cuts(colours: np.ndarray, landmarks: np.ndarray) -> list[int]:
    """Numbers of the pictures that begin another shot.

    A cut changes colours and moves the face, both at once: a light that is switched on does the first, a
    quick turn the second. Where the face is seen on one side only, colours alone have to tell; a film fades
    where they change slowly, which is no cut.

    Args:
        colours: (N, 64) of `colour_histogram`.
        landmarks: (N, L, 2 or 3) pixels, NaN where there is no face.
    """
    changed = 0.5 * np.abs(np.diff(colours.astype(np.float64), axis=0)).sum(axis=1)
    points = landmarks[..., :2].astype(np.float64)
    size = np.ptp(points, axis=1).max(axis=1)
    moved = np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1) / size[:-1]
    jumped = np.isnan(moved) | (moved > LANDMARK_JUMP)
    return [int(number) + 1 for number in np.flatnonzero((changed > COLOUR_JUMP) & jumped)]


def longest_continuous(person: np.ndarray, cuts: Sequence[int]) -> slice:
    """The longest run of pictures of one shot and one person, from its first that shows a face to its last.

    Pictures without a face are part of it where the same person is seen before and after. Of runs with as
    many pictures that show the face, the first.

    Args:
        person: (N,) int of `FaceTrack`, -1 where nobody is seen.
        cuts: Of `find_cuts`.

    Returns:
        Of the N pictures; empty where no face is seen at all.
    """
    shot = np.searchsorted(np.asarray(sorted(cuts)), np.arange(len(person)), side="right")
    seen = np.flatnonzero(person >= 0)
    if not len(seen):
        return slice(0, 0)
    breaks = np.flatnonzero((np.diff(person[seen]) != 0) | (np.diff(shot[seen]) != 0)) + 1
    longest = max(np.split(seen, breaks), key=len)
    return slice(int(longest[0]), int(longest[-1]) + 1)
