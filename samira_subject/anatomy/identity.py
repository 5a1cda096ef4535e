"""Twenty ways in which heads differ: displacements of the mean head, millimetres a standard deviation.

They bend the space that the head lies in, so that ears, teeth and eyes go along; eyeballs stay round.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from samira_subject.anatomy.assembly import Anatomy, mean_anatomy
from samira_subject.anatomy.eyes import EYE
from samira_subject.anatomy.rings import fade

Field = Callable[[np.ndarray], np.ndarray]
"""From (N, 3) points on the subject's left (x >= 0) to (N, 3) displacements."""


def _about(
    points: np.ndarray, centre: tuple[float, float, float], reach: tuple[float, float, float] | float
) -> np.ndarray:
    """(N, 1) 1 at a centre, a third at ``reach`` from it."""
    return np.exp(-(((points - centre) / reach) ** 2).sum(axis=1))[:, None]


def _push(
    centre: tuple[float, float, float],
    reach: tuple[float, float, float] | float,
    direction: tuple[float, float, float],
) -> Field:
    return lambda p: _about(p, centre, reach) * np.array(direction)


def _widen(centre: tuple[float, float, float], reach: tuple[float, float, float], share: float) -> Field:
    """Away from the plane of symmetry by a share of the distance to it."""
    return lambda p: _about(p, centre, reach) * np.column_stack([share * p[:, 0], 0.0 * p[:, :2]])


def _lower_face(p: np.ndarray) -> np.ndarray:
    """(N, 1) 0 above the nose's base, growing to 1 at the chin, for what lies in front of the neck."""
    return ((1.0 - fade(-p[:, 1], 40.0, 105.0)) * fade(-p[:, 2], 20.0, 75.0))[:, None]


IDENTITIES: dict[str, Field] = {
    "size": lambda p: 0.025 * (p - (0.0, -60.0, -80.0)),
    "head length": lambda p: np.column_stack(
        [0.0 * p[:, 0], 0.0 * p[:, 0], 0.035 * np.minimum(p[:, 2] + 40.0, 0.0) * fade(-p[:, 1], 10.0, 110.0)]
    ),
    "head breadth": lambda p: np.column_stack(
        [0.035 * p[:, 0] * fade(-p[:, 1], -30.0, 100.0), 0.0 * p[:, 0], 0.0 * p[:, 0]]
    ),
    "forehead height": _push((0.0, 110.0, -60.0), (90.0, 60.0, 90.0), (0.0, 5.0, 0.0)),
    "forehead slope": _push((0.0, 65.0, 10.0), (60.0, 32.0, 40.0), (0.0, 0.0, -3.5)),
    "brow": _push((22.0, 20.0, 18.0), (24.0, 11.0, 20.0), (0.0, 0.0, 2.2)),
    "eyes apart": _push((31.5, 0.0, 5.0), (24.0, 24.0, 30.0), (1.5, 0.0, 0.0)),
    "cheekbones": _push((58.0, -20.0, -14.0), (22.0, 17.0, 30.0), (3.0, 0.8, 1.2)),
    "cheeks": _push((44.0, -55.0, -5.0), (20.0, 22.0, 28.0), (3.2, 0.0, 2.0)),
    "jaw breadth": _widen((45.0, -88.0, -35.0), (40.0, 30.0, 50.0), 0.09),
    "chin height": lambda p: _lower_face(p) * (0.0, -4.5, 0.0),
    "chin": _push((0.0, -102.0, 20.0), (24.0, 18.0, 28.0), (0.0, 0.0, 4.0)),
    "chin breadth": _widen((0.0, -101.0, 15.0), (30.0, 18.0, 30.0), 0.14),
    "nose length": _push((0.0, -40.0, 35.0), (22.0, 18.0, 22.0), (0.0, -2.8, 0.4)),
    "nose breadth": _widen((0.0, -38.0, 28.0), (24.0, 14.0, 22.0), 0.09),
    "nose bridge": _push((0.0, -10.0, 24.0), (10.0, 18.0, 18.0), (0.0, 0.0, 2.4)),
    "nose tip": _push((0.0, -35.0, 42.0), (13.0, 10.0, 14.0), (0.0, 1.8, 1.8)),
    "mouth breadth": _widen((0.0, -66.0, 20.0), (40.0, 13.0, 30.0), 0.06),
    "lips": lambda p: (
        _push((0.0, -72.5, 30.0), (26.0, 6.0, 14.0), (0.0, -1.1, 1.6))(p)
        + _push((0.0, -61.5, 30.0), (26.0, 5.5, 14.0), (0.0, 0.9, 1.4))(p)
    ),
    "neck": lambda p: (
        np.column_stack([p[:, 0], 0.0 * p[:, 0], p[:, 2] + 88.0])
        * (0.07 * (1.0 - fade(p[:, 1], -90.0, -135.0)))[:, None]
    ),
}
"""By name; the signs are what the names say: longer, broader, higher, further out."""


@cache
def identities() -> np.ndarray:
    """(V, 3, 20) millimetres, symmetric."""
    anatomy = mean_anatomy()
    return np.stack([_symmetric(anatomy, field) for field in IDENTITIES.values()], axis=2)


def _symmetric(a: Anatomy, field: Field) -> np.ndarray:
    """(V, 3) displacement of the whole head by a field that is given on one side."""
    side = np.where(a.points[:, 0] < 0.0, -1.0, 1.0)[:, None] * (1.0, 0.0, 0.0) + (0.0, 1.0, 1.0)
    moved = field(a.points * side)
    # eyes move as one, and their lids the more with them the nearer their edge
    with_eye = np.where(a.is_part("left_eyeball", "right_eyeball"), 1.0, fade(a.lid, 2.0, 14.0))[:, None]
    moved = moved + with_eye * (field(EYE[None]) - moved)
    moved[a.points[:, 0] == 0.0, 0] = 0.0
    return moved * side
