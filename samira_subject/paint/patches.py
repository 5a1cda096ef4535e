"""Patches in hair and on the collar, lighter and darker: without them no picture would show how they move."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.rings import fade
from samira_subject.anatomy.sections import SECTIONS
from samira_subject.paint.layer import Paint
from samira_subject.paint.noise import value_noise
from samira_subject.paint.texels import Texels

PATCH = 7.0
"""Millimetres across, six pixels of the built-in subject."""

CONTRAST = 0.7
"""Natural logarithm of what the lightest and the darkest multiply the colour with."""

COLLAR = (35.0, 55.0)
"""Millimetres above the neck's end between which the collar's patches fade away."""


def with_patches(paint: Paint, t: Texels, hair: np.ndarray, *, seed: int) -> Paint:
    """Locks where (N,) ``hair`` is dense, and a knit about the neck's end."""
    height = t.points[:, 1] - min(section.front_y for section in SECTIONS)
    share = np.maximum(hair, fade(height, *COLLAR)) * t.is_part("skin")
    patches = value_noise(t.points / PATCH, seed=seed, field="patches")
    return paint.tinted(np.exp(CONTRAST * patches * share)[:, None])
