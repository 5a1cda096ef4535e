"""The built-in head in FLAME's layout, and the people it can be."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from samira_subject.anatomy.assembly import Anatomy, mean_anatomy
from samira_subject.anatomy.expressions import expressions
from samira_subject.anatomy.face_mesh import face_mesh
from samira_subject.anatomy.identity import IDENTITIES, identities
from samira_subject.anatomy.masks import masks
from samira_subject.anatomy.skinning import joint_regressor, skinning_weights
from samira_subject.streams import Purpose, generator_of
from samira_warp.head import FLAME_JOINTS, HeadTemplate

ORIGIN = np.array([0.0, 35.0, 70.0])
"""Millimetres from the anatomy's origin, between the eyes, to the template's, in the middle of the skull as
FLAME has it; added."""

SPREAD = 0.8
"""Standard deviations of other seeds' identities in units of the shapes: below 1, so that twenty at once stay
plausible."""

FARTHEST = 1.8
"""Coefficients stay within this: lids and lips close up to there (tests/subject/test_identity.py)."""


@dataclass(frozen=True, eq=False)
class SubjectHead:
    """A person.

    Attributes:
        template: The head model that all people share, in metres.
        anatomy: What is known of its vertices, in millimetres of the mean head.
        identity: (20,) float32 this person's coefficients of the identity shapes.
    """

    template: HeadTemplate
    anatomy: Anatomy
    identity: np.ndarray


def build_head(seed: int = 0) -> SubjectHead:
    """The head with one person's identity; seed 0 is the mean person."""
    identity = np.zeros(len(IDENTITIES))
    if seed:
        identity = np.clip(
            SPREAD * generator_of(seed, Purpose.IDENTITY).standard_normal(len(IDENTITIES)),
            -FARTHEST,
            FARTHEST,
        )
    return SubjectHead(build_template(), mean_anatomy(), identity.astype(np.float32))


@cache
def build_template() -> HeadTemplate:
    """The mean head with its shapes, joints, weights, atlas and regions."""
    anatomy = mean_anatomy()
    named = expressions()
    shapes = np.concatenate([identities(), np.stack(list(named.values()), axis=2)], axis=2)
    return HeadTemplate(
        v_template=((anatomy.points + ORIGIN) / 1000.0).astype(np.float32),
        shapedirs=(shapes / 1000.0).astype(np.float32),
        n_shape=len(IDENTITIES),
        posedirs=np.zeros((len(anatomy.points), 3, 9 * (len(FLAME_JOINTS) - 1)), np.float32),
        joint_regressor=joint_regressor(anatomy).astype(np.float32),
        parents=np.array([-1, 0, 1, 1, 1], np.int32),
        weights=skinning_weights(anatomy).astype(np.float32),
        faces=anatomy.faces.astype(np.int32),
        vt=anatomy.vt.astype(np.float32),
        ft=anatomy.ft.astype(np.int32),
        masks=masks(anatomy),
        expression_names=tuple(named),
        joint_names=FLAME_JOINTS,
        head_joint="neck",
        landmarks=face_mesh((anatomy.points + ORIGIN) / 1000.0, anatomy.faces),
    )
