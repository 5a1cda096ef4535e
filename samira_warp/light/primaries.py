"""From the primaries of a light file to those that shading works in, Rec. 709's (which are sRGB's).

Four chromaticities, of red, green, blue and white, say which XYZ a file's (1, 0, 0), (0, 1, 0) and (0, 0, 1)
are: columns in the directions of the primaries whose sum is white. What was white stays white: between the
two whites, Bradford's adaptation (ICC.1:2010, annex E).
"""

from __future__ import annotations

import numpy as np

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x and y of red, green, blue and white."""

NAMED = {
    "lin_rec709_scene": REC709,
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767),
    "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "lin_p3d65_scene": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
}
"""The linear spaces that files name instead (Color Interop Forum): ACEScg is AP1, ACES2065-1 AP0."""

_TOLERANCE = 1e-3
"""Chromaticities this close to Rec. 709's are those, written with fewer digits."""

_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]], np.float64
)


def to_rec709(chromaticities: tuple[float, ...]) -> np.ndarray | None:
    """The matrix from linear values of some primaries to linear Rec. 709.

    Args:
        chromaticities: x and y of red, green, blue and white.

    Returns:
        (3, 3) float64; None where they are Rec. 709's own.

    Raises:
        ValueError: They span no colours.
    """
    if len(chromaticities) != 8 or not np.isfinite(chromaticities).all():
        raise ValueError("not four chromaticities")
    if np.abs(np.subtract(chromaticities, REC709)).max() <= _TOLERANCE:
        return None
    source, source_white = _to_xyz(chromaticities)
    target, target_white = _to_xyz(REC709)
    gains = (_BRADFORD @ target_white) / (_BRADFORD @ source_white)
    adapt = np.linalg.solve(_BRADFORD, gains[:, None] * _BRADFORD)
    return np.linalg.solve(target, adapt @ source)


def _to_xyz(chromaticities: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The matrix from linear values to XYZ, and white's XYZ of luminance 1."""
    x, y = np.reshape(chromaticities, (4, 2)).T
    places = np.stack([x, y, 1.0 - x - y])
    if y[3] <= 0.0 or abs(np.linalg.det(places[:, :3])) < _TOLERANCE:
        raise ValueError("chromaticities that span no triangle")
    white = places[:, 3] / y[3]
    return places[:, :3] * np.linalg.solve(places[:, :3], white), white
