"""The filmic curve: radiance of any height bent into the range of a display, as film does it."""

from __future__ import annotations

from torch import Tensor

EXPOSURE = 0.6
"""Factor on the radiance before the fit, with which it is the curve of ACES itself."""

_NUMERATOR, _DENOMINATOR = (2.51, 0.03), (2.43, 0.59, 0.14)
"""Coefficients of x^2 and x, and of x^2, x and 1."""


def filmic(radiance: Tensor) -> Tensor:
    """Linear radiance of any shape to linear display values from 0 to 1, by channel, before the sRGB curve.

    Narkowicz's fit of the output transform of ACES (K. Narkowicz, "ACES Filmic Tone Mapping Curve", 2016;
    off by 0.0138 at most) at the exposure of the transform itself: 0.18 becomes 0.14, 0.4 becomes 0.36, 1
    becomes 0.67, and 12 and all above become 1. It rises wherever it is not 1; what is below 0 becomes 0.
    """
    x = EXPOSURE * radiance.clamp(min=0.0)
    a, b = _NUMERATOR
    c, d, e = _DENOMINATOR
    return (x * (a * x + b) / (x * (c * x + d) + e)).clamp(max=1.0)
