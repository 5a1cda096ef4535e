"""How bright a light is to be: a factor, or auto."""

from __future__ import annotations

import math
from numbers import Real
from typing import Literal

from samira_warp.support.errors import UserError

Exposure = float | Literal["auto"]
"""A factor on the light, or the one at which the luminance of the irradiance, averaged over all directions,
is 1."""


def check_exposure(exposure: Exposure, *, name: str = "exposure") -> None:
    """Raise UserError unless ``exposure`` is auto or a finite factor of at least 0.

    ``name`` is what it is called.
    """
    if exposure != "auto" and not (isinstance(exposure, Real) and 0.0 <= exposure < math.inf):
        raise UserError(name, expected="a factor of at least 0, or auto", found=exposure)
