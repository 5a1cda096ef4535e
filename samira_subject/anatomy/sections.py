"""The head without its features: a stack of rounded sections from the crown to the foot of the neck.

Lengths are millimetres; the origin lies midway between the eyeballs' centres, x to the subject's left, y up,
z out of the face. The surface is a function of two numbers: ``azimuth`` in radians, 0 in front, pi/2 on the
subject's left, pi behind, and ``descent``, the length in millimetres that one has come down from the crown.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline


class Section(NamedTuple):
    """One closed curve about the head: where it crosses front, side and back, and how square it is."""

    front_y: float
    front_z: float
    side_x: float
    side_y: float
    side_z: float
    back_y: float
    back_z: float
    front_power: float
    back_power: float


SECTIONS = (
    Section(122.0, -70.0, 3.0, 122.0, -73.0, 122.0, -76.0, 2.0, 2.0),
    Section(115.0, -30.0, 38.0, 114.5, -76.0, 114.0, -120.0, 2.1, 2.1),
    Section(102.0, -6.0, 57.5, 99.0, -77.0, 98.0, -146.0, 2.15, 2.1),
    Section(89.0, 8.0, 68.5, 83.0, -77.0, 79.0, -162.0, 2.15, 2.1),
    Section(75.0, 16.0, 75.0, 65.0, -77.0, 58.0, -171.0, 2.2, 2.1),
    Section(58.0, 21.5, 77.0, 47.0, -76.0, 38.0, -174.5, 2.25, 2.1),
    Section(40.0, 23.5, 77.0, 30.0, -76.0, 20.0, -174.0, 2.25, 2.1),
    Section(21.0, 22.0, 76.0, 13.0, -76.0, 1.0, -169.5, 2.2, 2.1),
    Section(3.0, 17.5, 74.0, -4.0, -76.0, -18.0, -161.0, 2.1, 2.1),
    Section(-18.0, 17.0, 71.0, -22.0, -74.0, -38.0, -151.0, 2.05, 2.15),
    Section(-40.0, 20.0, 67.0, -41.0, -70.0, -56.0, -143.0, 2.05, 2.2),
    Section(-55.0, 22.0, 62.0, -57.0, -67.0, -72.0, -137.0, 2.05, 2.2),
    Section(-68.0, 21.0, 58.0, -72.0, -67.0, -86.0, -133.0, 2.0, 2.2),
    Section(-82.0, 19.0, 53.5, -88.0, -69.0, -98.0, -130.0, 2.0, 2.2),
    Section(-97.0, 22.0, 50.0, -100.0, -75.0, -108.0, -129.0, 2.0, 2.2),
    Section(-111.0, 14.0, 48.0, -112.0, -81.0, -118.0, -129.0, 2.0, 2.2),
    Section(-117.0, -6.0, 47.0, -121.0, -84.0, -127.0, -130.0, 2.0, 2.2),
    Section(-121.0, -25.0, 47.0, -131.0, -86.0, -138.0, -132.0, 2.0, 2.2),
    Section(-131.0, -37.0, 48.0, -145.0, -88.0, -151.0, -134.0, 2.05, 2.2),
    Section(-152.0, -42.0, 52.0, -163.0, -91.0, -168.0, -138.0, 2.05, 2.2),
    Section(-172.0, -43.0, 62.0, -180.0, -94.0, -184.0, -145.0, 2.1, 2.2),
    Section(-188.0, -39.0, 82.0, -192.0, -96.0, -196.0, -153.0, 2.2, 2.2),
)
"""An adult between the sexes, after the means of facial anthropometry (Farkas, 1994): length 197, breadth
154, pupil to chin 112."""


@cache
def _splines() -> tuple[CubicSpline, np.ndarray]:
    """The sections as a smooth function of descent, and the sections' descents."""
    rows = np.array(SECTIONS)
    front = np.hypot(np.diff(rows[:, 0]), np.diff(rows[:, 1]))
    side = np.hypot(np.diff(rows[:, 2]), np.diff(rows[:, 3]))
    descents = np.concatenate([[0.0], np.cumsum(0.5 * (front + side))])
    return CubicSpline(descents, rows), descents


def lowest_descent() -> float:
    """Where the neck ends."""
    return float(_splines()[1][-1])


def descent_of_front(y: np.ndarray | float) -> np.ndarray:
    """Descent at which the front of the head is ``y`` high."""
    dense = np.linspace(0.0, lowest_descent(), 4001)
    return np.interp(-np.asarray(y, np.float64), -_splines()[0](dense)[:, 0], dense)


def section_surface(azimuth: np.ndarray, descent: np.ndarray) -> np.ndarray:
    """(..., 3) points of the bare head at (...) azimuths and descents."""
    row = Section(*np.moveaxis(_splines()[0](descent), -1, 0))
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    ahead = cosine > 0.0
    reach = np.where(ahead, row.front_z - row.side_z, row.side_z - row.back_z)
    power = np.where(ahead, row.front_power, row.back_power)
    radius = ((np.abs(sine) / row.side_x) ** power + (np.abs(cosine) / reach) ** power) ** (-1.0 / power)
    middle = np.where(ahead, row.front_y, row.back_y)
    # a tilted section: heights blend by how far one has gone round
    y = row.side_y + (middle - row.side_y) * cosine**2
    return np.stack([radius * sine, y, row.side_z + radius * cosine], axis=-1)


def locate(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and descents of the bare head's points that lie at the (N, 3) points' heights and bearings."""
    descent = descent_of_front(points[:, 1])
    azimuth = np.zeros(len(points))
    for _ in range(30):
        axis = _splines()[0](descent)[:, 4]
        azimuth = np.arctan2(points[:, 0], points[:, 2] - axis)
        step = section_surface(azimuth, descent)[:, 1] - points[:, 1]
        descent = np.clip(descent + 0.7 * step, 1.0, lowest_descent())
    return azimuth, descent
