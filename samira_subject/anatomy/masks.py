"""The named regions of FLAME's head, on ours."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.sections import SECTIONS

HAIRLINE = (
    (22.0, 61.0),
    (10.0, 63.5),
    (0.0, 62.0),
    (-12.0, 54.0),
    (-24.0, 40.0),
    (-36.0, 21.0),
    (-48.0, 1.0),
    (-58.0, -15.0),
    (-65.0, -25.0),
    (-72.0, -25.0),
    (-78.0, 6.0),
    (-92.0, 13.0),
    (-106.0, 0.0),
    (-116.0, -38.0),
    (-134.0, -74.0),
    (-180.0, -80.0),
)
"""Depth and height of the hair's edge, millimetres: forehead, temples, sideburns in front of the ears, round
behind them, nape."""


def hairline(points: np.ndarray) -> np.ndarray:
    """(N,) signed millimetres, about, from the hair's edge: positive where hair grows."""
    depth, height = np.array(HAIRLINE[::-1]).T
    return points[:, 1] - np.interp(points[:, 2], depth, height)


def masks(a: Anatomy) -> dict[str, np.ndarray]:
    """Vertex ids of each region; they may overlap, as FLAME's do."""
    x, y, z = a.points.T
    skin = a.is_part("skin")
    left = x > 0.0
    hair = hairline(a.points) > 0.0
    front = z > -66.0
    above_chin = y > np.interp(z, [-66.0, -40.0, 0.0, 20.0], [-72.0, -98.0, -115.0, -118.0])
    face = skin & ~hair & front & above_chin
    neck = skin & ~hair & ~face & (y < -45.0)
    around_eye = skin & (a.lid < 11.0)
    nose_width = np.interp(-y, [-6.0, 8.0, 25.0, 40.0, 49.0], [7.0, 9.0, 16.0, 22.0, 19.0])
    nose = skin & (np.abs(x) < nose_width) & (y < 6.0) & (y > -49.5) & (z > 8.0) & ~around_eye & (a.lip > 6.0)
    forehead = face & (y > 14.0) & ~around_eye & (z > -40.0)
    foot = min(section.front_y for section in SECTIONS)
    named = {
        "face": face,
        "neck": neck,
        "scalp": skin & ~face & ~neck,
        "boundary": skin & (y < foot + 10.0),
        "forehead": forehead,
        "nose": nose,
        "lips": skin & (a.lip <= 0.6),
        "left_eye_region": around_eye & left,
        "right_eye_region": around_eye & ~left,
        "eye_region": around_eye,
        "left_eyeball": a.is_part("left_eyeball"),
        "right_eyeball": a.is_part("right_eyeball"),
        "left_ear": a.is_part("left_ear"),
        "right_ear": a.is_part("right_ear"),
        "teeth": a.is_part("teeth_upper", "teeth_lower"),
        "mouth": a.is_part("mouth", "tongue"),
    }
    return {name: np.flatnonzero(chosen).astype(np.int32) for name, chosen in named.items()}
