"""Eyelids and eyeballs, on the subject's left; the right ones mirror them."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.landmarks import face_surface, seen_at
from samira_subject.anatomy.rings import Ring, disc_triangles, fade, smooth_maximum

EYE = np.array([31.5, 0.0, 0.0])
"""Centre of the left eyeball; adults' pupils are 63 mm apart."""

EYE_RADIUS = 13.0
"""Millimetres."""

CORNEA = 0.45
"""Millimetres by which the cornea stands out of the globe: half of nature, as linear lids cut across it in a
blink."""

LID = 1.5
"""Millimetres between the globe and the outer edge of the lids."""

IRIS_RADIUS = 5.9
"""Millimetres."""

LID_VERTICES = 30

INSIDE = np.array([-14.0, -1.7])
OUTSIDE = np.array([13.2, 0.9])
"""The canthi in front view, from the eyeball's centre."""

DISTANCES = (0.0, 1.3, 2.9, 4.6, 6.2, 7.8, 10.0, 13.0, 16.0)
"""Millimetres from the lid's edge to each ring, above the eye."""

CREASE = 6.2
"""Millimetres from the upper lid's edge to its fold."""


def lid_arch(turn: np.ndarray) -> np.ndarray:
    """(N,) 1 over and under the middle of the eye, 0 at its corners, at angles as `lid_edge` takes them."""
    return np.abs(np.sin(turn)) ** 1.25


def lid_edge(turn: np.ndarray) -> np.ndarray:
    """(N, 2) the almond in front view from the eyeball's centre.

    Angles start at the outer canthus and run over the upper lid.
    """
    across = np.cos(turn)
    line = INSIDE + (OUTSIDE - INSIDE) * (0.5 * (across + 1.0))[:, None]
    arch = lid_arch(turn)
    upper = 4.9 * arch * (1.0 - 0.16 * across)
    lower = -5.0 * arch * (1.0 + 0.22 * across)
    return line + np.stack([np.zeros_like(turn), np.where(np.sin(turn) >= 0.0, upper, lower)], axis=1)


def on_globe(flat: np.ndarray, radius: float) -> np.ndarray:
    """(N, 3) points in front of the eyeball at front-view places from its centre.

    Beside the globe they stay at the canthi's depth.
    """
    depth = np.sqrt(np.maximum(radius**2 - (flat**2).sum(axis=1), 0.0))
    beside = 3.2 - 1.9 * np.clip(flat[:, 0] / 14.0, -1.0, 1.0)
    return EYE + np.column_stack([flat, smooth_maximum(depth, beside, 2.0)])


def lid_rings() -> tuple[list[Ring], list[Ring]]:
    """Rings from behind the lid to its edge, and from there over the skin to the orbit's rim.

    Angles run counter-clockwise in front.
    """
    turn = 2.0 * np.pi * np.arange(LID_VERTICES) / LID_VERTICES
    edge = lid_edge(turn)
    rim = on_globe(edge, EYE_RADIUS + LID)
    outer = [_skin_ring(turn, edge, rim, distance) for distance in DISTANCES]
    inward = edge / np.linalg.norm(edge, axis=1, keepdims=True)
    chart = outer[0].chart
    ones = np.ones(LID_VERTICES)
    # towards the canthi the lining runs from the edge to the globe, in sight; elsewhere it hides behind the
    # lid
    corner = (np.abs(np.cos(turn)) ** 8)[:, None]
    lining = (1.0 - corner) * (edge + 1.2 * inward) + corner * 0.86 * edge
    inner = [
        Ring(chart, _sunk(on_globe(lining, EYE_RADIUS - 0.3), 5.0), -7.0 * ones),
        Ring(chart, on_globe(lining, EYE_RADIUS + 0.1), -2.0 * ones),
        Ring(chart, on_globe(edge - 0.25 * inward, EYE_RADIUS + 0.2), -1.0 * ones),
    ]
    return inner, outer


def _sunk(points: np.ndarray, depth: float) -> np.ndarray:
    return points - (0.0, 0.0, depth)


def _skin_ring(turn: np.ndarray, edge: np.ndarray, rim: np.ndarray, distance: float) -> Ring:
    """The ring at a distance from the lid's edge: the face, drawn to the rim and pushed out by the globe."""
    up, out = np.sin(turn), np.cos(turn)
    share = distance / DISTANCES[-1]
    reach = np.stack([out * np.where(out > 0.0, 10.0, 5.5), up * np.where(up > 0.0, 15.5, 14.0)], axis=1)
    flat = edge + share * reach
    azimuth, descent = seen_at(EYE[0] + flat[:, 0], EYE[1] + flat[:, 1])
    chart = np.stack([azimuth, descent], axis=1)
    if distance == 0.0:
        return Ring(chart, rim, np.zeros(len(turn)))
    here = face_surface(azimuth, descent)
    at_edge = face_surface(*seen_at(EYE[0] + edge[:, 0], EYE[1] + edge[:, 1]))
    points = here + fade(share, 0.0, 1.0)[..., None] * (rim - at_edge)
    points[:, 2] += _folds(up, share * 15.5)
    from_globe = points - EYE
    length = np.linalg.norm(from_globe, axis=1)
    wanted = smooth_maximum(
        length, np.full_like(length, EYE_RADIUS + LID + 0.35 - 1.5 * share), 0.8 * (1.0 - share)
    )
    return Ring(chart, EYE + from_globe * (wanted / length)[:, None], np.full(len(turn), share * 15.5))


def _folds(up: np.ndarray, distance: float) -> np.ndarray:
    """(N,) millimetres forward: the upper lid's crease with the fold over it, and the lower lid's bag."""
    above, below = np.clip(up, 0.0, 1.0) ** 0.6, np.clip(-up, 0.0, 1.0) ** 0.8
    crease = -1.7 * np.exp(-(((distance - CREASE) / 1.3) ** 2)) + 1.3 * np.exp(
        -(((distance - 9.0) / 2.5) ** 2)
    )
    bag = 0.5 * np.exp(-(((distance - 4.0) / 2.0) ** 2)) - 0.7 * np.exp(-(((distance - 8.5) / 2.0) ** 2))
    return above * crease + below * bag


def eyeball() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (N, 3), triangles (T, 3) and chart (N, 2) in [-1, 1]^2 of the left eyeball, pole in front.

    The chart gives the iris more room than the white.
    """
    angles = np.radians([0.0, 7.0, 14.0, 21.0, 28.0, 34.0, 42.0, 52.0, 64.0, 78.0, 95.0, 120.0])
    count = 20
    turn = 2.0 * np.pi * np.arange(count) / count
    points, chart = [EYE + np.array([0.0, 0.0, _globe(0.0)])], [np.zeros(2)]
    for angle in angles[1:]:
        direction = np.column_stack(
            [np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.full(count, np.cos(angle))]
        )
        points.extend(EYE + direction * _globe(angle))
        chart.extend((angle / angles[-1]) ** 0.6 * np.column_stack([np.cos(turn), np.sin(turn)]))
    return np.array(points), disc_triangles(count, len(angles) - 1), np.array(chart)


def _globe(angle: float) -> float:
    """Distance from the centre to the surface at an angle from the axis: the cornea stands out."""
    return EYE_RADIUS + CORNEA * float(fade(angle, 0.1, 0.56))
