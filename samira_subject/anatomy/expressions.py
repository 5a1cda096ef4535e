"""The named expressions: linear displacements of the mean head, in millimetres.

Those of one side are modelled on the subject's left and mirrored. An expression is a sum of pulls, each with
a smooth reach; what lies on lids and lips is told apart by the openings' own coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from samira_subject.anatomy.assembly import Anatomy, mean_anatomy
from samira_subject.anatomy.eyelids_motion import blink, squint, widen
from samira_subject.anatomy.lips_motion import (
    dimple,
    frown,
    funnel,
    lower_down,
    press,
    pucker,
    roll_lower,
    roll_upper,
    shift,
    shrug_lower,
    shrug_upper,
    smile,
    stretch,
    upper_up,
)
from samira_subject.anatomy.pulls import jaw_share, pull

Shape = Callable[[Anatomy], np.ndarray]
"""From the mean head to (V, 3) displacements."""


def _brow_down(a: Anatomy) -> np.ndarray:
    return pull(a, (13.0, 18.0, 20.0), 11.0, (-3.0, -4.5, 1.5)) + pull(
        a, (31.0, 20.0, 17.0), 14.0, (-2.0, -4.5, 1.0)
    )


def _brow_inner_up(a: Anatomy) -> np.ndarray:
    lift = pull(a, (12.0, 19.0, 21.0), 13.0, (1.0, 6.5, 0.3)) + pull(
        a, (13.0, 38.0, 22.0), 18.0, (0.0, 3.0, 0.6)
    )
    return _both_sides(a, lift)


def _brow_outer_up(a: Anatomy) -> np.ndarray:
    return pull(a, (38.0, 19.0, 11.0), 13.0, (0.5, 7.0, 0.0)) + pull(
        a, (36.0, 38.0, 13.0), 18.0, (0.0, 3.0, 0.0)
    )


def _cheek_puff(a: Anatomy) -> np.ndarray:
    return pull(a, (43.0, -60.0, 0.0), 19.0, (8.0, 0.0, 6.0)) + pull(
        a, (25.0, -56.0, 18.0), 11.0, (0.5, 0.0, 3.0)
    )


def _cheek_squint(a: Anatomy) -> np.ndarray:
    return pull(a, (36.0, -26.0, 11.0), 15.0, (1.5, 5.0, 3.0))


def _nose_sneer(a: Anatomy) -> np.ndarray:
    wing = pull(a, (16.0, -36.0, 24.0), 9.0, (1.2, 4.0, -0.5))
    return (
        wing
        + pull(a, (11.0, -16.0, 18.0), 9.0, (-0.8, 2.0, 1.3))
        + pull(a, (17.0, -56.0, 25.0), 9.0, (0.5, 2.8, 0.6))
    )


def _jaw(direction: tuple[float, float, float]) -> Shape:
    return lambda a: jaw_share(a)[:, None] * np.array(direction)


def _both_sides(a: Anatomy, left: np.ndarray) -> np.ndarray:
    """The sum of a displacement and its mirror image."""
    return left + left[a.mirror] * (-1.0, 1.0, 1.0)


SIDED: dict[str, Shape] = {
    "browDown": _brow_down,
    "browOuterUp": _brow_outer_up,
    "cheekPuff": _cheek_puff,
    "cheekSquint": _cheek_squint,
    "eyeBlink": blink,
    "eyeSquint": squint,
    "eyeWide": widen,
    "mouthDimple": dimple,
    "mouthFrown": frown,
    "mouthLowerDown": lower_down,
    "mouthPress": press,
    "mouthSmile": smile,
    "mouthStretch": stretch,
    "mouthUpperUp": upper_up,
    "noseSneer": _nose_sneer,
}
"""Expressions of one side, which get the suffixes _L and _R."""

WHOLE: dict[str, Shape] = {
    "browInnerUp": _brow_inner_up,
    "jawForward": _jaw((0.0, 0.0, 6.0)),
    "jawLeft": _jaw((7.0, 0.0, 0.0)),
    "jawRight": _jaw((-7.0, 0.0, 0.0)),
    "mouthFunnel": funnel,
    "mouthLeft": shift,
    "mouthPucker": pucker,
    "mouthRight": lambda a: shift(a)[a.mirror] * (-1.0, 1.0, 1.0),
    "mouthRollLower": roll_lower,
    "mouthRollUpper": roll_upper,
    "mouthShrugLower": shrug_lower,
    "mouthShrugUpper": shrug_upper,
}
"""Expressions of the whole face."""


@cache
def expressions() -> dict[str, np.ndarray]:
    """(V, 3) millimetres of each expression at full strength, by the name that face trackers share."""
    anatomy = mean_anatomy()
    shapes = {name: shape(anatomy) for name, shape in WHOLE.items()}
    for name, shape in SIDED.items():
        left = shape(anatomy)
        shapes[f"{name}_L"] = left
        shapes[f"{name}_R"] = left[anatomy.mirror] * (-1.0, 1.0, 1.0)
    return dict(sorted(shapes.items()))
