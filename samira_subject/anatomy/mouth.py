"""Lips and the mouth behind them: the subject's left half.

It goes from the midline below round the corner to the midline above.
"""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.landmarks import face_surface, seen_at
from samira_subject.anatomy.rings import Ring, fade

HALF_WIDTH = 25.0
"""Millimetres from the midline to the corner of the mouth."""

LINE = -66.5
"""Height at which the lips meet, millimetres."""

HALF_VERTICES = 25

VERMILION = (0.0, 0.16, 0.36, 0.6, 0.82, 1.0)
"""Where rings run on the lips: 0 where they meet, 1 at the border to the skin."""

SKIN = (1.2, 3.0, 5.5, 8.5, 12.0)
"""Millimetres from the border to rings on the skin around."""

WITHIN = -20.0
"""What lies behind where the lips meet has this as its distance to the lips' border, or less."""

CAVITY = (
    (62.0, 5.0, 0.55),
    (44.0, 16.0, 0.9),
    (24.0, 20.0, 1.12),
    (9.0, 19.0, 1.12),
    (4.6, 13.0, 1.06),
    (4.2, 4.0, 1.0),
    (3.0, 0.1, 1.0),
    (1.4, 0.0, 1.0),
)
"""Rings within the mouth: millimetres behind the lips, above and below their line, and width. The lips touch
over the last two."""


def _turn() -> np.ndarray:
    """(N,) angles from below to above."""
    return np.linspace(-0.5 * np.pi, 0.5 * np.pi, HALF_VERTICES)


def _heights(turn: np.ndarray) -> np.ndarray:
    """(N,) how far the lips reach above (below) the line where they meet, with the bow of the upper one."""
    across = np.cos(turn)
    upper = 8.0 * (1.0 - across**1.5) - 1.3 * np.exp(-((across / 0.12) ** 2))
    lower = -9.0 * (1.0 - across**2.2)
    return np.where(turn > 0.0, upper, lower)


def _contact(turn: np.ndarray) -> np.ndarray:
    """(N, 3) where the lips meet: a line that bows down in the middle and dips at the corners."""
    across = np.cos(turn)
    bow = (
        -0.9 * np.exp(-((across / 0.16) ** 2))
        + 0.7 * np.exp(-(((across - 0.5) / 0.25) ** 2))
        - 0.8 * across**6
    )
    gap = 0.03 * np.sign(turn) * (1.0 - across**4)
    depth = 14.0 + 12.5 * (1.0 - across**2) ** 0.85
    return np.column_stack([HALF_WIDTH * across, LINE + bow + gap, depth])


def _border(turn: np.ndarray) -> np.ndarray:
    """(N, 3) border of the vermilion, on the face, raised a little."""
    contact, across = _contact(turn), np.cos(turn)
    x = contact[:, 0] + 1.6 * across**8
    y = contact[:, 1] + _heights(turn)
    points = face_surface(*seen_at(x, y))
    points[:, 2] += 0.5 - 0.6 * across**4
    return points


def lip_rings() -> tuple[list[Ring], list[Ring]]:
    """Rings from deep in the mouth to where the lips meet, and from there over the lips to the skin."""
    turn = _turn()
    contact, border = _contact(turn), _border(turn)
    outer = [_vermilion_ring(turn, contact, border, share) for share in VERMILION]
    outer += [_skin_ring(turn, border, distance) for distance in SKIN]
    inner = [
        Ring(outer[0].chart, points, np.full(len(turn), WITHIN - (len(CAVITY) - 1 - index)))
        for index, points in enumerate(_cavity(turn))
    ]
    return inner, outer


def _vermilion_ring(turn: np.ndarray, contact: np.ndarray, border: np.ndarray, share: float) -> Ring:
    across = np.cos(turn)
    points = contact + share * (border - contact)
    full = (1.0 - across**3) * np.where(
        turn > 0.0, 1.7 + 0.9 * np.exp(-((across / 0.2) ** 2)), 3.0 - 0.5 * np.exp(-((across / 0.15) ** 2))
    )
    points[:, 2] = (
        contact[:, 2]
        + (border - contact)[:, 2] * np.sin(0.5 * np.pi * share)
        + full * np.sin(np.pi * share**0.75)
    )
    points[:, 1] += np.where(turn > 0.0, -0.8, 1.0) * (1.0 - across**3) * np.sin(np.pi * share)
    open_share = 0.25 + 0.75 * share
    chart_x = contact[:, 0] + (border - contact)[:, 0] * share
    chart_y = contact[:, 1] + (border - contact)[:, 1] * open_share
    width = np.hypot(*(border - contact)[:, :2].T)
    return Ring(np.stack(seen_at(chart_x, chart_y), axis=1), points, -(1.0 - share) * np.maximum(width, 1.0))


def _skin_ring(turn: np.ndarray, border: np.ndarray, distance: float) -> Ring:
    share = distance / SKIN[-1]
    rim = np.column_stack(
        [(HALF_WIDTH + 12.5) * np.cos(turn), LINE - 1.0 + np.where(turn > 0.0, 16.8, 21.0) * np.sin(turn)]
    )
    flat = border[:, :2] + share * (rim - border[:, :2])
    flat[[0, -1], 0] = 0.0
    chart = np.stack(seen_at(flat[:, 0], flat[:, 1]), axis=1)
    points = face_surface(*chart.T)
    at_border = face_surface(*seen_at(border[:, 0], border[:, 1]))
    points += fade(share, 0.0, 1.0)[..., None] * (border - at_border)
    points[:, 2] -= (
        0.9 * np.exp(-(((np.cos(turn) - 1.0) / 0.14) ** 2)) * np.exp(-(((distance - 2.0) / 2.5) ** 2))
    )
    return Ring(chart, points, np.full(len(turn), distance))


def _cavity(turn: np.ndarray) -> list[np.ndarray]:
    """From the deepest ring to the one just behind the lips: over the gums, back along palate and floor."""
    across, up = np.cos(turn), np.sin(turn)
    above = up > 0.0
    rings = []
    for back, spread, width in CAVITY:
        arch = 1.0 - across**4
        y = LINE + np.where(above, spread, -1.05 * spread) * arch * (up != 0.0)
        curve = 11.0 * (1.0 - across**2) ** 0.85
        z = 14.0 + curve * (1.0 if back < 30.0 else 0.3) - back
        rings.append(np.column_stack([HALF_WIDTH * width * across, y, z]))
    return rings
