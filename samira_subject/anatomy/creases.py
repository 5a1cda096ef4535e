"""Grooves, ridges and dents too fine for landmarks.

Where the nostrils open, where the nose's wings and the lips' folds begin.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np


class Crease(NamedTuple):
    """A groove along a line.

    Attributes:
        line: Corners in millimetres, on the subject's left.
        width: Millimetres from the middle to where it has faded to a third.
        push: Displacement in its middle, millimetres.
    """

    line: tuple[tuple[float, float, float], ...]
    width: float
    push: tuple[float, float, float]


CREASES = (
    # round the wing of the nose
    Crease(
        ((16.0, -29.0, 20.0), (20.0, -35.0, 18.0), (20.5, -40.0, 18.0), (18.0, -45.5, 19.5)),
        2.2,
        (0.2, 0.0, -2.2),
    ),
    Crease(((9.0, -27.5, 30.5), (12.5, -29.5, 27.5), (15.5, -29.5, 22.0)), 2.2, (-0.8, 0.0, -0.9)),
    Crease(((14.0, -35.0, 31.0), (17.0, -38.5, 27.5), (15.5, -43.5, 26.0)), 3.2, (1.3, 0.0, 0.9)),
    # the nostril, and the soft triangle in front of it
    Crease(((10.0, -44.5, 29.5), (7.0, -45.0, 34.5)), 2.9, (-0.3, 5.8, -2.6)),
    Crease(((0.0, -42.0, 39.0), (0.0, -46.0, 32.5)), 2.6, (0.0, -0.5, 0.5)),
    # philtrum and its ridges
    Crease(((0.0, -50.0, 30.0), (0.0, -58.5, 31.0)), 3.0, (0.0, 0.0, -1.3)),
    Crease(((4.0, -49.5, 30.0), (5.5, -58.5, 31.0)), 1.9, (0.0, 0.0, 0.8)),
    # nose to mouth
    Crease(
        ((22.0, -37.0, 17.0), (27.0, -46.0, 17.0), (31.5, -57.0, 13.0), (33.0, -65.0, 10.0)),
        3.2,
        (0.0, 0.0, -1.1),
    ),
    # tip
    Crease(((3.2, -33.5, 43.0), (3.6, -37.0, 42.5)), 3.6, (0.5, 0.0, 0.5)),
)


def with_creases(points: np.ndarray) -> np.ndarray:
    """(N, 3) points with every crease in place, on both sides of the head."""
    sides = np.array([1.0, 1.0, 1.0]), np.array([-1.0, 1.0, 1.0])
    moved = points.copy()
    for crease in CREASES:
        middle = crease.line[0][0] == 0.0 and crease.line[-1][0] == 0.0
        for side in sides[:1] if middle else sides:
            distance = _distance_to_line(points, np.array(crease.line) * side)
            moved += np.exp(-((distance / crease.width) ** 2))[:, None] * (np.array(crease.push) * side)
    return moved


def _distance_to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    best = np.full(len(points), np.inf)
    for start, end in itertools.pairwise(line):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - start - share[:, None] * along, axis=1))
    return best
