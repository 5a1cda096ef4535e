"""Teeth with their gums, and the tongue."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from samira_subject.anatomy.rings import disc_triangles

COLUMNS = 29

REACH = 25.0
"""Millimetres from the midline to the last tooth that is modelled."""


class Part(NamedTuple):
    """A part of its own: points, triangles, and what its paint goes by.

    That is (N, 3) points, (T, 3) triangles, its (N, 2) chart in [-1, 1]^2 and (N, 2) paint coordinates. The
    first paint coordinate counts teeth from the midline; the second is 0 at the gum's line, 1 at the edge,
    below 0 on the gum.
    """

    points: np.ndarray
    triangles: np.ndarray
    chart: np.ndarray
    paint: np.ndarray


UPPER = (
    (-51.0, 3.0, -0.5),
    (-56.5, 0.2, -0.12),
    (-59.0, 0.0, 0.05),
    (-63.5, 0.0, 0.5),
    (-67.6, -0.4, 1.0),
    (-67.2, -2.6, 1.02),
    (-60.0, -6.5, 1.2),
    (-53.0, -9.0, 1.4),
)
"""Rows of the upper teeth: height, millimetres in front of the arch, paint."""

LOWER = (
    (-83.0, 1.5, -0.5),
    (-78.0, 0.2, -0.12),
    (-75.5, 0.0, 0.05),
    (-71.0, 0.2, 0.5),
    (-66.9, -0.2, 1.0),
    (-67.2, -2.4, 1.02),
    (-74.0, -6.0, 1.2),
    (-81.0, -8.0, 1.4),
)
"""Rows of the lower teeth; their edges pass behind those of the upper ones."""

FRONT_UPPER, FRONT_LOWER = 23.5, 20.5
"""Millimetres, z of the incisors."""


def teeth(*, upper: bool) -> Part:
    """One arch, from the subject's right to the left."""
    rows = UPPER if upper else LOWER
    front = FRONT_UPPER if upper else FRONT_LOWER
    across = np.linspace(-1.0, 1.0, COLUMNS)
    x = REACH * np.sin(0.5 * np.pi * across)
    arch = np.column_stack([x, np.zeros(COLUMNS), front - 30.0 * np.abs(x / REACH) ** 2.3])
    tangent = np.gradient(arch, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.column_stack([-tangent[:, 2], np.zeros(COLUMNS), tangent[:, 0]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(arch, axis=0), axis=1))])
    count = (length - length[COLUMNS // 2]) / 7.6
    points, paint, chart = [], [], []
    for index, (y, ahead, height) in enumerate(rows):
        rise = 0.9 * np.clip(np.abs(across) - 0.15, 0.0, None) * (1.0 if upper else -0.3)
        points.append(arch + normal * ahead + np.column_stack([0.0 * x, y + rise, 0.0 * x]))
        paint.append(np.column_stack([count, np.full(COLUMNS, height)]))
        chart.append(
            np.column_stack(
                [across, np.full(COLUMNS, (1.0 - 2.0 * index / (len(rows) - 1)) * (1.0 if upper else -1.0))]
            )
        )
    here = np.arange(COLUMNS - 1)
    triangles = []
    for row in range(len(rows) - 1):
        a, b = row * COLUMNS + here, (row + 1) * COLUMNS + here
        triangles += [np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])]
    joined = np.concatenate(triangles)
    return Part(
        np.concatenate(points),
        joined if upper else joined[:, [0, 2, 1]],
        np.concatenate(chart),
        np.concatenate(paint),
    )


def tongue() -> Part:
    """A rounded body on the mouth's floor, its pole on top in front."""
    count = 14
    turn = 2.0 * np.pi * np.arange(count) / count
    points, chart = [np.array([[0.0, -72.5, -4.0]])], [np.zeros((1, 2))]
    for angle in np.radians([22.0, 44.0, 64.0, 84.0, 110.0]):
        side, up = np.sin(angle), np.cos(angle)
        ring = np.column_stack(
            [19.0 * side * np.cos(turn), -82.0 + 9.5 * np.full(count, up), -12.0 - 26.0 * side * np.sin(turn)]
        )
        groove = 1.2 * np.exp(-((ring[:, 0] / 4.0) ** 2)) * (up > 0.0)
        ring[:, 1] -= groove
        points.append(ring)
        chart.append(angle / np.radians(110.0) * np.column_stack([np.cos(turn), np.sin(turn)]))
    joined = np.concatenate(points)
    return Part(joined, disc_triangles(count, 5), np.concatenate(chart), np.zeros((len(joined), 2)))
