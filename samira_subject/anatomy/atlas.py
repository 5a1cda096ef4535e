"""Where each part lies in the square of texture: the skin unrolled on top, the rest in a band below."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from samira_subject.anatomy.layout import HalfSkin
from samira_subject.anatomy.mouth import WITHIN
from samira_subject.anatomy.sections import lowest_descent

BAND = 0.25
"""Height of the band of small parts."""

FRONT_SHARE = 0.35
"""How much denser than the average the face lies in the atlas than the back of the head: 1.35 to 0.65."""

PLACES = {
    "left_eyeball": (0.072, 0.125, 0.066, 0.112),
    "right_eyeball": (0.214, 0.125, 0.066, 0.112),
    "mouth": (0.370, 0.125, 0.080, 0.112),
    "left_ear": (0.530, 0.125, 0.070, 0.112),
    "right_ear": (0.682, 0.125, 0.070, 0.112),
    "teeth_upper": (0.880, 0.203, 0.113, 0.036),
    "teeth_lower": (0.880, 0.120, 0.113, 0.036),
    "tongue": (0.880, 0.040, 0.100, 0.034),
}
"""Middle and half sizes of the small parts' places: u, v, half width, half height."""


class Chart(NamedTuple):
    """A part of the atlas: (T, 2) places, and the (F, 3) ids of the faces' corners among them."""

    vt: np.ndarray
    ft: np.ndarray


def part_chart(flat: np.ndarray, faces: np.ndarray, name: str) -> Chart:
    """A part that is unrolled in [-1, 1]^2."""
    u, v, half_width, half_height = PLACES[name]
    return Chart(np.array([u, v]) + flat * (half_width, half_height), faces)


def skin_chart(half: HalfSkin) -> Chart:
    """The skin, cut open down the back of the head, and the lining of the mouth as a disc.

    The left half's faces come first, then the right's.
    """
    left = _unrolled(half)
    right = left * (-1.0, 1.0) + (1.0, 0.0)
    bag_left = _lining(half)
    bag_right = bag_left * (-1.0, 1.0) + (2.0 * PLACES["mouth"][0], 0.0)
    count = len(half.points)
    # a face belongs to the lining when it has a corner behind where the lips meet
    lined = (half.lip[half.triangles] <= WITHIN).any(axis=1)
    faces = np.concatenate(
        [half.triangles + lined[:, None] * count, half.triangles[:, [0, 2, 1]] + (2 + lined[:, None]) * count]
    )
    vt = np.concatenate([left, bag_left, right, bag_right])
    # the crown is one vertex, but every face has a corner of its own there
    vt, faces = _split_pole(vt, faces, {count - 1, 3 * count - 1})
    used, ids = np.unique(faces, return_inverse=True)
    return Chart(vt[used], ids.reshape(faces.shape))


def _split_pole(vt: np.ndarray, faces: np.ndarray, poles: set[int]) -> tuple[np.ndarray, np.ndarray]:
    """Give each face at a pole a corner of its own, above the middle of its side."""
    faces = faces.copy()
    extra = []
    for face in np.flatnonzero(np.isin(faces, list(poles)).any(axis=1)):
        corner = int(np.flatnonzero(np.isin(faces[face], list(poles)))[0])
        others = np.delete(faces[face], corner)
        extra.append([vt[others, 0].mean(), vt[faces[face, corner], 1]])
        faces[face, corner] = len(vt) + len(extra) - 1
    return np.concatenate([vt, np.array(extra)]), faces


def _unrolled(half: HalfSkin) -> np.ndarray:
    """(N, 2) places of the left half's skin; rings behind the lids shrink into the eye's opening."""
    azimuth, descent = half.chart.T
    u = 0.5 + 0.495 * (azimuth + FRONT_SHARE * np.sin(azimuth)) / np.pi
    v = BAND + 0.005 + (0.99 - BAND) * (1.0 - descent / lowest_descent())
    places = np.column_stack([u, v])
    behind = half.lid < 0.0
    middle = places[(half.lid == 0.0)].mean(axis=0)
    shrink = 1.0 + np.maximum(half.lid, -5.0) / 8.0
    places[behind] = (middle + shrink[:, None] * (places - middle))[behind]
    return places


def _lining(half: HalfSkin) -> np.ndarray:
    """(N, 2) places of the left half's vertices in the mouth's disc, whose middle is the throat."""
    u, v, half_width, half_height = PLACES["mouth"]
    radius = 1.0 - half.cavity
    return np.array([u, v]) + radius[:, None] * np.column_stack(
        [half_width * np.cos(half.turn), half_height * np.sin(half.turn)]
    )
