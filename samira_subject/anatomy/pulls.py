"""Smooth displacements from which expressions are made."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.mouth import HALF_WIDTH, LINE, SKIN
from samira_subject.anatomy.rings import fade

Vector = tuple[float, float, float]

HINGE = np.array([0.0, -20.0, -78.0])
"""Middle of the jaw's axis, millimetres: between the condyles, in front of the ears."""


def moves_with_skin(a: Anatomy) -> np.ndarray:
    """(V,) bool: skin and the lining of the mouth, what muscles of expression move."""
    return a.is_part("skin", "mouth")


def pull(a: Anatomy, centre: Vector, reach: float, direction: Vector) -> np.ndarray:
    """(V, 3) displacement of the skin about a point, faded to a third at ``reach`` millimetres.

    Lids yield less the nearer their edge.
    """
    squared = ((a.points - centre) ** 2).sum(axis=1)
    share = np.exp(-squared / reach**2) * moves_with_skin(a) * (1.0 - fade(a.lid, 0.0, 9.0))
    return share[:, None] * np.array(direction)


def left_share(a: Anatomy) -> np.ndarray:
    """(V,) 1 on the subject's left, 0 on the right, and a half on the midline."""
    return 1.0 - fade(a.points[:, 0], -6.0, 6.0)


def upper_share(a: Anatomy) -> np.ndarray:
    """(V,) 1 above an opening, 0 below, a half at its corners.

    It is steep there, as lips part along all of their length.
    """
    return np.clip(0.5 + 0.5 * np.sign(a.turn) * np.abs(np.sin(a.turn)) ** 0.6, 0.0, 1.0)


def around_mouth(a: Anatomy, reach: float) -> np.ndarray:
    """(V,) 1 on the lips and within, fading over ``reach`` millimetres of skin around."""
    across = np.maximum(np.abs(a.points[:, 0]) - HALF_WIDTH, 0.0)
    up = np.maximum(np.abs(a.points[:, 1] - LINE) - 6.0, 0.0)
    outside = np.hypot(across, up)
    near = fade(outside, 0.0, reach) * fade(a.points[:, 2], 0.0, -14.0)
    lining = fade(a.cavity, 0.3, 0.75)
    return np.where(a.is_part("mouth"), lining, near * a.is_part("skin"))


def jaw_share(a: Anatomy) -> np.ndarray:
    """(V,) how much each vertex goes with the jaw.

    It is 1 on the lower lip, chin, lower teeth and tongue, 0 on the upper lip and the skull. What divides
    them is the line from the jaw's axis to where the lips meet: sharp between the lips, wide over the cheeks.
    """
    x, y, z = a.points.T
    line = LINE + (LINE - HINGE[1]) * (z - 27.0) / (27.0 - HINGE[2])
    below = line - y
    width = 1.2 + 19.0 * (1.0 - fade(np.abs(x), 19.0, 40.0))
    share = 1.0 - fade(below, -width, width)
    under_chin = -(y + 110.0) + 0.5 * (17.0 - z)
    share = share * fade(under_chin, 12.0, 52.0) * fade(z, -62.0, -84.0)
    on_lips = a.lip < SKIN[-1]
    opened = 1.0 - upper_share(a)
    blend = fade(a.lip, 1.5, SKIN[-1])
    share = np.where(on_lips, blend * opened + (1.0 - blend) * share, share)
    lining = opened * fade(a.cavity, 0.55, 1.0)
    share = np.where(a.is_part("mouth"), lining, share)
    share[a.is_part("teeth_lower", "tongue")] = 1.0
    share[a.is_part("teeth_upper", "left_ear", "right_ear", "left_eyeball", "right_eyeball")] = 0.0
    return share
