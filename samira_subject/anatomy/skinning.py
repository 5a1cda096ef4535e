"""Joints and skinning weights."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.eyes import EYE
from samira_subject.anatomy.pulls import HINGE, jaw_share
from samira_subject.anatomy.rings import fade

JOINTS = np.array([(0.0, -175.0, -92.0), (0.0, -92.0, -92.0), HINGE, EYE, EYE * (-1.0, 1.0, 1.0)])
"""Millimetres: root at the foot of the neck, neck below the skull, jaw, left eye, right eye, in FLAME's
order."""

SUPPORT = 100
"""Vertices that a joint within the head is regressed from."""


def skinning_weights(a: Anatomy) -> np.ndarray:
    """(V, 5) shares of the joints, which sum to 1.

    The neck bends over its length, and what is above it goes with the head.
    """
    weights = np.zeros((len(a.points), 5))
    # the neck's top and foot are lower in front than behind
    height = a.points[:, 1] + 0.25 * (a.points[:, 2] + 90.0)
    head = fade(-height, 95.0, 165.0)
    jaw = jaw_share(a)
    for joint, name in ((3, "left_eyeball"), (4, "right_eyeball")):
        weights[a.is_part(name), joint] = 1.0
    rest = 1.0 - weights.sum(axis=1)
    weights[:, 0] = rest * (1.0 - head)
    weights[:, 1] = rest * head * (1.0 - jaw)
    weights[:, 2] = rest * head * jaw
    return weights


def joint_regressor(a: Anatomy) -> np.ndarray:
    """(5, V) weights, summing to 1, that give `JOINTS` from the mean head.

    They are the smallest on the vertices about each joint that do. Eyes are regressed from their eyeballs, so
    that they stay in the middle of them whatever the identity; their two rows mirror.
    """
    regressor = np.zeros((5, len(a.points)))
    skin = a.is_part("skin")
    for joint in (0, 1, 2):
        _regress(regressor, a, joint, np.flatnonzero(skin))
        regressor[joint] = 0.5 * (regressor[joint] + regressor[joint, a.mirror])
    _regress(regressor, a, 3, np.flatnonzero(a.is_part("left_eyeball")))
    regressor[4] = regressor[3, a.mirror]
    return regressor


def _regress(regressor: np.ndarray, a: Anatomy, joint: int, candidates: np.ndarray) -> None:
    """Fill one row."""
    if joint < 3:
        # the vertices all round at the joint's height, so that it lies among them
        nearest = candidates[
            np.argsort(np.abs(a.points[candidates, 1] - JOINTS[joint, 1]), kind="stable")[:SUPPORT]
        ]
        candidates = np.unique(np.concatenate([nearest, a.mirror[nearest]]))
    system = np.concatenate([a.points[candidates].T, np.ones((1, len(candidates)))])
    # the least solution of an underdetermined system; einsum sums in one order whatever the number of threads
    squared = np.einsum("ik,jk->ij", system, system)
    regressor[joint, candidates] = np.einsum(
        "ik,i->k", system, np.linalg.solve(squared, np.append(JOINTS[joint], 1.0))
    )
