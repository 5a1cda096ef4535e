"""Expressions of the mouth; those of one side move the subject's left."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.mouth import HALF_WIDTH, LINE, SKIN, WITHIN
from samira_subject.anatomy.pulls import Vector, around_mouth, left_share, pull, upper_share
from samira_subject.anatomy.rings import fade


def _corner(a: Anatomy, direction: Vector, *, reach: float = 20.0) -> np.ndarray:
    """(V, 3) displacement of the left corner, which the lips follow less and less towards the middle."""
    along = np.clip(a.points[:, 0] / HALF_WIDTH, 0.0, 1.0) ** 1.3
    lips = along * around_mouth(a, 6.0)
    squared = (((a.points - (HALF_WIDTH + 3.0, LINE, 13.0)) / (reach, 0.9 * reach, reach)) ** 2).sum(axis=1)
    skin = np.exp(-squared) * a.is_part("skin")
    return np.maximum(lips, skin)[:, None] * np.array(direction)


def _upper(a: Anatomy) -> np.ndarray:
    """(V,) 1 on what moves with the upper lip, 0 on what moves with the lower one."""
    height = 1.0 - fade(a.points[:, 1], LINE - 4.0, LINE + 4.0)
    return np.where(a.lip < SKIN[-1], upper_share(a), height)


def _lip(a: Anatomy, *, upper: bool, reach: float) -> np.ndarray:
    """(V,) 1 on one lip's edge, fading over ``reach`` millimetres of skin and towards the corners."""
    share = _upper(a) if upper else 1.0 - _upper(a)
    middle = fade(np.abs(a.points[:, 0]), 8.0, HALF_WIDTH + 2.0)
    return share * around_mouth(a, reach) * middle


def _vermilion(a: Anatomy, *, upper: bool) -> np.ndarray:
    """(V,) 1 where the lips meet, 0 from the border of the vermilion on, and fading within the mouth."""
    share = _upper(a) if upper else 1.0 - _upper(a)
    on_lip = fade(a.lip, -7.0, 0.5) * (a.lip > WITHIN) + (a.lip <= WITHIN) * fade(a.cavity, 0.1, 0.5)
    return share * on_lip * np.clip(np.abs(np.sin(a.turn)) * 1.6, 0.0, 1.0)


def smile(a: Anatomy) -> np.ndarray:
    """The corner goes out, up and back; the cheek bulges above it."""
    cheek = pull(a, (37.0, -36.0, 11.0), 15.0, (2.5, 4.5, 2.5)) + pull(
        a, (33.0, -22.0, 12.0), 11.0, (0.5, 1.6, 1.0)
    )
    wing = pull(a, (17.5, -40.0, 22.0), 8.0, (1.6, 0.6, -0.4))
    thin = -_vermilion(a, upper=True)[:, None] * np.array((0.0, -0.8, 0.8)) * left_share(a)[:, None]
    return _corner(a, (6.0, 6.0, -4.5)) + cheek + wing + thin


def frown(a: Anatomy) -> np.ndarray:
    """The corner goes down."""
    return _corner(a, (0.5, -6.0, -1.5), reach=17.0) + pull(a, (20.0, -88.0, 17.0), 12.0, (0.0, -1.0, 1.0))


def dimple(a: Anatomy) -> np.ndarray:
    """The corner goes in."""
    return _corner(a, (3.5, 0.5, -4.0), reach=13.0)


def stretch(a: Anatomy) -> np.ndarray:
    """The corner goes out and down, and the neck's skin tightens."""
    return _corner(a, (7.0, -3.0, -5.0), reach=22.0)


def upper_up(a: Anatomy) -> np.ndarray:
    """The left half of the upper lip goes up, and the fold beside the nose with it."""
    lift = (_lip(a, upper=True, reach=13.0) * left_share(a))[:, None] * np.array((0.6, 5.5, 0.6))
    return lift + pull(a, (22.0, -44.0, 18.0), 10.0, (1.0, 2.5, 1.2))


def lower_down(a: Anatomy) -> np.ndarray:
    """The left half of the lower lip goes down."""
    return (_lip(a, upper=False, reach=14.0) * left_share(a))[:, None] * np.array((0.8, -5.5, -0.6))


def press(a: Anatomy) -> np.ndarray:
    """The lips flatten against each other."""
    share = (_vermilion(a, upper=True) + _vermilion(a, upper=False)) * left_share(a)
    rim = around_mouth(a, 7.0) * fade(np.abs(a.lip), 0.0, 6.0) * left_share(a)
    toward = np.where(_upper(a) > 0.5, -1.6, 1.6)
    return np.column_stack([0.0 * share, rim * toward, -1.2 * share - 0.6 * rim])


def pucker(a: Anatomy) -> np.ndarray:
    """The lips come together and forward."""
    share = around_mouth(a, 17.0)
    x = a.points[:, 0]
    forward = 6.5 * share * fade(np.abs(x), 4.0, 30.0)
    full = np.where(_upper(a) > 0.5, 0.8, -0.8) * fade(np.abs(a.lip), 0.0, 8.0) * fade(np.abs(x), 0.0, 20.0)
    return np.column_stack([-0.34 * x * share, full, forward])


def funnel(a: Anatomy) -> np.ndarray:
    """The lips open to a ring and come forward."""
    share = around_mouth(a, 17.0)
    x = a.points[:, 0]
    opened = _lip(a, upper=True, reach=12.0) * 4.0 - _lip(a, upper=False, reach=13.0) * 5.0
    return np.column_stack([-0.22 * x * share, opened, 5.5 * share * fade(np.abs(x), 6.0, 30.0)])


def roll_upper(a: Anatomy) -> np.ndarray:
    """The upper lip turns in over the teeth."""
    share = _vermilion(a, upper=True)
    rim = _lip(a, upper=True, reach=8.0)
    return np.column_stack([0.0 * share, -1.2 * rim, -2.6 * share - 0.8 * rim])


def roll_lower(a: Anatomy) -> np.ndarray:
    """The lower lip turns in over the teeth."""
    share = _vermilion(a, upper=False)
    rim = _lip(a, upper=False, reach=9.0)
    return np.column_stack([0.0 * share, 1.8 * rim, -3.0 * share - 0.8 * rim])


def shrug_upper(a: Anatomy) -> np.ndarray:
    """The upper lip goes up and forward."""
    return _lip(a, upper=True, reach=13.0)[:, None] * np.array((0.0, 2.6, 1.6))


def shrug_lower(a: Anatomy) -> np.ndarray:
    """The chin pushes the lower lip up and out, and the upper one with it."""
    chin = pull(a, (0.0, -95.0, 24.0), 16.0, (0.0, 4.0, 1.5))
    lips = _lip(a, upper=False, reach=12.0)[:, None] * np.array((0.0, 2.4, 2.2))
    return chin + lips + _lip(a, upper=True, reach=9.0)[:, None] * np.array((0.0, 2.0, 1.0))


def shift(a: Anatomy) -> np.ndarray:
    """The mouth goes to the left."""
    return around_mouth(a, 22.0)[:, None] * np.array((7.0, 0.0, -0.5))
