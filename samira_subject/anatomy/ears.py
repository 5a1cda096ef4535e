"""The left ear: a shell with its folds, rooted in the side of the head; the right one mirrors it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from samira_subject.anatomy.rings import disc_triangles, fade

ROOT = np.array([74.0, -12.0, -78.0])
"""Where the ear's own coordinates begin, on the head in front of the ear, millimetres."""

PROTRUSION = np.radians(23.0)
"""Angle between the ear and the side of the head."""

TILT = np.radians(12.0)
"""Angle by which the ear leans back."""

OUTLINE = (
    (33.0, 12.0),
    (30.0, 24.0),
    (22.0, 31.0),
    (12.0, 31.5),
    (3.0, 25.0),
    (-1.0, 13.0),
    (-3.0, 2.0),
    (-3.0, -9.0),
    (-1.0, -20.0),
    (2.5, -29.0),
    (9.0, -31.5),
    (16.0, -26.0),
    (23.0, -14.0),
    (30.0, -1.0),
)
"""Back and up, millimetres in the ear's plane, round from the back."""

MIDDLE = np.array([13.0, 1.0])
"""The pole of the ear's vertices, in its plane."""

SHARES = (0.2, 0.38, 0.52, 0.62, 0.71, 0.79, 0.86, 0.93, 0.99)
"""Rings of the front, as shares of the way from the middle to the outline."""

BACK = ((1.02, -1.6), (0.97, -4.2), (0.8, -6.5), (0.5, -16.0))
"""Rings of the back: share, and depth behind the plane."""

COUNT = 24


class Shell(NamedTuple):
    """A part of its own: (N, 3) points, (T, 3) triangles and its (N, 2) chart in [-1, 1]^2."""

    points: np.ndarray
    triangles: np.ndarray
    chart: np.ndarray


def ear() -> Shell:
    """Build the left ear."""
    turn = 2.0 * np.pi * np.arange(COUNT) / COUNT
    outline = _outline(turn)
    plane = [
        MIDDLE[None],
        *(MIDDLE + share * (outline - MIDDLE) for share in SHARES),
        *(MIDDLE + s * (outline - MIDDLE) for s, _ in BACK),
    ]
    depth = [_relief(plane[0], np.zeros(1), np.zeros(1))]
    depth += [
        _relief(flat, np.full(COUNT, share), turn) for share, flat in zip(SHARES, plane[1:], strict=False)
    ]
    depth += [np.full(COUNT, value) for _, value in BACK]
    radii = np.linspace(0.0, 1.0, len(plane))
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return Shell(
        points=_place(np.concatenate(plane), np.concatenate(depth)),
        triangles=disc_triangles(COUNT, len(plane) - 1),
        chart=np.concatenate([np.zeros((1, 2)), *(radius * circle for radius in radii[1:])]),
    )


def _outline(turn: np.ndarray) -> np.ndarray:
    """(N, 2) the ear's edge at angles about the middle."""
    corners = np.array([*OUTLINE, OUTLINE[0]]) - MIDDLE
    angles = np.unwrap(np.arctan2(corners[:, 1], corners[:, 0]))
    radius = CubicSpline(angles, np.linalg.norm(corners, axis=1), bc_type="periodic")(turn)
    return MIDDLE + radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])


def _bump(flat: np.ndarray, centre: tuple[float, float], radii: tuple[float, float]) -> np.ndarray:
    return np.exp(-(((flat - centre) / radii) ** 2).sum(axis=1))


def _relief(flat: np.ndarray, share: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(N,) millimetres out of the ear's plane: helix, scapha, antihelix, concha, tragus, antitragus, lobe."""
    angle = np.degrees(np.mod(turn + 1.2, 2.0 * np.pi) - 1.2)
    curled = fade(angle, 185.0, 215.0) * fade(angle, -35.0, -62.0)
    behind = fade(angle, 95.0, 150.0) * fade(angle, -40.0, -70.0)
    helix = 3.6 * curled * np.exp(-(((share - 0.93) / 0.075) ** 2))
    scapha = -1.6 * curled * np.exp(-(((share - 0.78) / 0.08) ** 2))
    antihelix = 3.0 * behind * np.exp(-(((share - 0.6) / 0.11) ** 2))
    concha = -7.5 * _bump(flat, (9.0, -3.0), (8.5, 9.5))
    cymba = -3.5 * _bump(flat, (9.0, 8.0), (8.0, 4.5))
    tragus = 6.5 * _bump(flat, (-0.5, -5.0), (4.0, 5.0))
    antitragus = 5.0 * _bump(flat, (9.5, -15.5), (4.5, 3.5))
    fossa = -1.8 * _bump(flat, (14.0, 20.0), (6.0, 4.0))
    lobe = 1.5 * _bump(flat, (8.0, -25.0), (7.0, 6.0))
    return helix + scapha + antihelix + concha + cymba + tragus + antitragus + fossa + lobe


def _place(flat: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(N, 3) points of the head from places and heights in the ear's plane."""
    up = np.array([0.0, np.cos(TILT), -np.sin(TILT)])
    back = np.array([np.sin(PROTRUSION), 0.0, -np.cos(PROTRUSION)])
    back -= (back @ up) * up
    back /= np.linalg.norm(back)
    outwards = np.cross(back, up)
    outwards *= np.sign(outwards[0])
    # the ear bends round the head: its plane curls in towards the back
    curl = -0.006 * np.clip(flat[:, 0], 0.0, None) ** 2
    # and leans in below, to where the lobe hangs on the jaw
    curl += 0.2 * np.clip(flat[:, 1], None, 0.0)
    return ROOT + flat[:, :1] * back + flat[:, 1:] * up + (depth + curl)[:, None] * outwards
