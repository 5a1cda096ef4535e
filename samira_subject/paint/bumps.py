"""Bumps and wrinkles: heights over the skin, and their slopes.

Wrinkles come with expressions and are in no template: a tracker cannot know them, an avatar has to learn
them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from samira_subject.anatomy.rings import fade
from samira_subject.paint.noise import fractal_noise, value_noise
from samira_subject.paint.texels import Texels

Line = tuple[tuple[float, float], ...]
"""Corners in front view on the subject's left, millimetres."""


class Wrinkle(NamedTuple):
    """Grooves that open with some expressions.

    Attributes:
        lines: Where they run, both sides.
        depth: Millimetres at full strength.
        width: Millimetres from a groove's middle to where it has faded to a third.
        drivers: Expressions of the side, without suffix, or of the whole face, and how strongly each opens
            the grooves.
    """

    lines: tuple[Line, ...]
    depth: float
    width: float
    drivers: dict[str, float]


WRINKLES = (
    Wrinkle(
        (
            ((0.0, 33.0), (14.0, 34.0), (28.0, 37.0), (42.0, 34.0)),
            ((0.0, 41.0), (15.0, 43.0), (30.0, 46.0), (45.0, 41.0)),
            ((0.0, 50.5), (16.0, 52.0), (31.0, 54.0), (43.0, 49.0)),
        ),
        0.55,
        1.7,
        {"browInnerUp": 0.7, "browOuterUp": 0.6},
    ),
    Wrinkle((((4.5, 12.0), (5.5, 22.0), (4.0, 29.0)),), 0.6, 1.6, {"browDown": 1.0}),
    Wrinkle(
        (((0.0, 7.0), (5.0, 7.5)), ((0.0, 3.5), (6.0, 4.5))), 0.35, 1.3, {"browDown": 0.8, "noseSneer": 0.7}
    ),
    Wrinkle(
        (((3.0, -6.0), (9.0, -10.0)), ((4.0, -10.5), (10.5, -15.0)), ((5.5, -15.0), (11.0, -19.0))),
        0.35,
        1.3,
        {"noseSneer": 1.0},
    ),
    Wrinkle(
        (
            ((48.0, 3.5), (54.0, 8.0), (59.0, 10.0)),
            ((49.0, 0.0), (57.0, 0.5)),
            ((48.0, -3.5), (54.0, -7.5), (58.0, -11.0)),
        ),
        0.5,
        1.4,
        {"eyeSquint": 0.8, "mouthSmile": 0.4, "cheekSquint": 0.4},
    ),
    Wrinkle(
        (((20.0, -9.5), (28.0, -12.5), (38.0, -11.5)), ((24.0, -14.0), (33.0, -16.0), (42.0, -13.0))),
        0.35,
        1.4,
        {"eyeSquint": 1.0, "cheekSquint": 0.4},
    ),
    Wrinkle(
        (((21.5, -36.0), (26.5, -44.0), (31.5, -54.0), (34.0, -64.0)),),
        0.9,
        2.1,
        {"mouthSmile": 0.9, "noseSneer": 0.6, "mouthUpperUp": 0.5, "mouthStretch": 0.5, "cheekSquint": 0.3},
    ),
    Wrinkle(
        (((29.5, -61.0), (31.5, -66.5), (30.0, -72.0)),),
        0.6,
        1.5,
        {"mouthDimple": 1.0, "mouthSmile": 0.4, "mouthStretch": 0.5},
    ),
    Wrinkle(
        (((27.5, -69.0), (29.5, -77.0), (28.5, -86.0)),), 0.7, 1.8, {"mouthFrown": 1.0, "mouthStretch": 0.4}
    ),
    Wrinkle(
        (((0.0, -84.5), (9.0, -84.0), (16.0, -81.5)),),
        0.8,
        2.0,
        {"mouthShrugLower": 1.0, "mouthFrown": 0.4, "mouthPress": 0.4},
    ),
    Wrinkle(
        (
            ((4.0, -52.0), (4.5, -58.0)),
            ((10.0, -53.0), (9.5, -59.0)),
            ((16.0, -56.0), (14.0, -61.0)),
            ((8.0, -79.0), (8.0, -84.0)),
            ((15.0, -76.0), (14.0, -81.0)),
        ),
        0.4,
        1.2,
        {"mouthPucker": 1.0, "mouthPress": 0.4},
    ),
)
"""After the muscles: frontalis, corrugator, procerus, nasalis, orbicularis of the eye, zygomaticus, risorius,
depressor, mentalis, orbicularis of the mouth."""


def resting_heights(t: Texels, *, hair: np.ndarray, brows: np.ndarray, seed: int) -> np.ndarray:
    """(N,) millimetres of what is always there: pores, the lips' lines, the tongue's grain, hair."""
    skin = t.is_part("skin", "left_ear", "right_ear")
    pores = 0.035 * value_noise(t.points / 1.5, seed=seed, field="fine pores") + 0.05 * fractal_noise(
        t.points, wavelength=4.5, octaves=2, seed=seed, field="coarse pores"
    )
    lips = (
        0.09
        * value_noise(t.points * (0.75, 0.1, 0.2), seed=seed, field="lip grooves")
        * fade(t.lip, -2.0, 0.0)
    )
    crop = 0.08 * value_noise(t.points / 0.9, seed=seed, field="crop") * hair + 0.2 * brows
    return (pores + lips + crop) * skin


def wrinkle_heights(t: Texels, wrinkle: Wrinkle, *, left: bool) -> np.ndarray:
    """(N,) millimetres of a wrinkle's grooves on one side at full strength: sunk, and raised beside."""
    side = t.points[:, 0] if left else -t.points[:, 0]
    here = t.is_part("skin") & (t.points[:, 2] > -32.0) & (side > -12.0)
    flat = np.column_stack([side, t.points[:, 1]])[here]
    total = np.zeros(len(flat))
    for line in wrinkle.lines:
        distance, share = _distance(flat, line)
        groove = np.exp(-((distance / wrinkle.width) ** 2)) - 0.45 * np.exp(
            -(((distance - 2.3 * wrinkle.width) / (1.3 * wrinkle.width)) ** 2)
        )
        total -= groove * share
    heights = np.zeros(len(t.points))
    heights[here] = wrinkle.depth * total
    # the two sides share what lies on the midline
    return heights * (t.lid > 0.0) * (1.0 - fade(side, -4.0, 4.0))


def _distance(flat: np.ndarray, line: Line) -> tuple[np.ndarray, np.ndarray]:
    """(N,) millimetres to a line, and how much of its depth a groove has there.

    It thins out at its ends off the midline.
    """
    corners = np.array(line)
    begins_in_the_middle = corners[0, 0] == 0.0
    if begins_in_the_middle:
        corners = np.concatenate([corners[1:2] * (-1.0, 1.0), corners])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    best, place = np.full(len(flat), np.inf), np.zeros(len(flat))
    for index, (start, end) in enumerate(itertools.pairwise(corners)):
        along = end - start
        share = np.clip((flat - start) @ along / (along @ along), 0.0, 1.0)
        distance = np.linalg.norm(flat - start - share[:, None] * along, axis=1)
        nearer = distance < best
        best = np.where(nearer, distance, best)
        place = np.where(nearer, (lengths[index] + share * np.linalg.norm(along)) / lengths[-1], place)
    begins = 1.0 if begins_in_the_middle else 1.0 - fade(place, 0.0, 0.3)
    return best, begins * fade(place, 0.65, 1.0)


class Slopes:
    """Takes heights in the atlas to their gradients over the head."""

    def __init__(self, t: Texels, gradients: Sequence[np.ndarray]) -> None:
        """Keep what each texel needs.

        Args:
            t: The texels.
            gradients: (N, 3) gradients of u and of v over the mean head, per millimetre.
        """
        self._t = t
        self._u, self._v = gradients
        index = np.full((t.size + 2, t.size + 2), -1)
        index[1:-1, 1:-1][t.covered] = np.arange(len(t.points))
        rows, columns = np.nonzero(t.covered)
        self._neighbours = [
            self._same_part(index[rows + 1 + dy, columns + 1 + dx])
            for dy, dx in ((0, 1), (0, -1), (-1, 0), (1, 0))
        ]

    def _same_part(self, other: np.ndarray) -> np.ndarray:
        """Ids of neighbours, the texel's own where there is none of its part."""
        own = np.arange(len(other))
        known = (other >= 0) & (self._t.part[other] == self._t.part)
        return np.where(known, other, own)

    def of(self, heights: np.ndarray) -> np.ndarray:
        """(N, 3) gradients, without unit, of (N,) heights in millimetres."""
        right, left, up, down = self._neighbours
        own = np.arange(len(heights))
        across = np.maximum((right != own).astype(float) + (left != own), 1.0)
        upwards = np.maximum((up != own).astype(float) + (down != own), 1.0)
        by_u = (heights[right] - heights[left]) * self._t.size / across
        by_v = (heights[up] - heights[down]) * self._t.size / upwards
        return by_u[:, None] * self._u + by_v[:, None] * self._v
