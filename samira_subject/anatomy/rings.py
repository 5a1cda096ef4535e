"""Rings of vertices that lead the surface round an opening."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Ring:
    """Vertices in a row about an opening.

    Attributes:
        chart: (N, 2) azimuth in radians and descent in millimetres: where on the unrolled head they lie.
        points: (N, 3) millimetres.
        outwards: (N,) millimetres of skin between them and the opening's edge; negative within the opening.
    """

    chart: np.ndarray
    points: np.ndarray
    outwards: np.ndarray


def strip(count: int, inner: int, outer: int, *, closed: bool) -> np.ndarray:
    """(T, 3) triangles between two rings of ``count`` vertices that begin at ids ``inner`` and ``outer``.

    Outwards for rings that run counter-clockwise as seen from outside the head.
    """
    here = np.arange(count if closed else count - 1)
    there = (here + 1) % count
    corners = np.stack([inner + here, outer + here, outer + there, inner + there], axis=1)
    # both diagonals in turn, so that a mirrored ring is split the mirrored way
    even = corners[:, [0, 1, 2, 0, 2, 3]]
    odd = corners[:, [0, 1, 3, 1, 2, 3]]
    return np.where((here % 2 == 0)[:, None], even, odd).reshape(-1, 3)


def disc_triangles(count: int, rings: int) -> np.ndarray:
    """(T, 3) triangles of a pole, vertex 0, and rings of ``count`` vertices about it."""
    here, there = np.arange(count), (np.arange(count) + 1) % count
    triangles = [np.column_stack([np.zeros(count, int), 1 + here, 1 + there])]
    for ring in range(rings - 1):
        inner, outer = 1 + count * ring, 1 + count * (ring + 1)
        triangles.append(np.column_stack([inner + here, outer + here, outer + there]))
        triangles.append(np.column_stack([inner + here, outer + there, inner + there]))
    return np.concatenate(triangles)


def smooth_maximum(a: np.ndarray, b: np.ndarray, softness: float) -> np.ndarray:
    """The larger of two lengths, rounded off where they differ by less than about ``softness``."""
    return 0.5 * (a + b + np.sqrt((a - b) ** 2 + softness**2))


def fade(x: np.ndarray | float, start: np.ndarray | float, end: np.ndarray | float) -> np.ndarray:
    """1 up to ``start``, 0 from ``end`` on, smooth between; the other way round where ``start`` is larger."""
    t = np.clip((np.asarray(x, np.float64) - start) / (end - start), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)
