"""Hair: a close crop on the scalp, and brows."""

from __future__ import annotations

import numpy as np

from samira_warp.subject.anatomy.masks import hairline
from samira_warp.subject.anatomy.rings import fade
from samira_warp.subject.paint.layer import Paint
from samira_warp.subject.paint.look import Look
from samira_warp.subject.paint.noise import fractal_noise, value_noise
from samira_warp.subject.paint.texels import Texels

BROW = ((11.0, 15.5, 4.0), (18.0, 18.0, 4.3), (28.0, 20.5, 3.9), (37.0, 21.5, 3.0), (45.0, 18.5, 2.1), (52.0, 13.0, 0.9))
"""Middle of the brow in front view and its half height, millimetres, from the nose outwards."""


def scalp_share(t: Texels, *, seed: int) -> np.ndarray:
    """(N,) how dense the crop is: full on the scalp, thinning over a centimetre at its edge."""
    edge = hairline(t.points) + 5.0 * fractal_noise(t.points, wavelength=11.0, octaves=4, seed=seed + 80)
    return (1.0 - fade(edge, -5.0, 13.0)) * t.is_part("skin")


def with_scalp(paint: Paint, t: Texels, look: Look, *, seed: int) -> Paint:
    """Cropped hair, streaked along the way it lies."""
    share = scalp_share(t, seed=seed)
    streak = 0.6 * value_noise(t.points * (0.55, 0.13, 0.55), seed=seed + 81) + 0.5 * value_noise(t.points / 0.9, seed=seed + 82)
    colour = np.array(look.hair) * np.exp(0.35 * streak)[:, None]
    crop = Paint.plain(colour, roughness=0.72, specular=0.028, scatter=0.0)
    thin = np.clip(value_noise(t.points / 0.8, seed=seed + 83) * 0.9 + 2.4 * share - 0.7, 0.0, 1.0)
    return paint.under(crop, 0.94 * share**0.7 * thin)


def brow_share(t: Texels, *, seed: int) -> np.ndarray:
    """(N,) how dense the brows are: hairs that stand up by the nose and lie outwards at the temple."""
    across, y, z = np.abs(t.points[:, 0]), t.points[:, 1], t.points[:, 2]
    middle, half = (np.interp(across, [b[0] for b in BROW], [b[k] for b in BROW]) for k in (1, 2))
    height = (y - middle) / half
    along = fade(across, 51.0, 54.0) * (1.0 - fade(across, 8.5, 13.0))
    body = fade(np.abs(height), 0.3, 1.2) * along * (z > -25.0) * t.is_part("skin")
    # hairs lean from upright to level as one goes out
    lean = np.radians(np.interp(across, [10.0, 18.0, 30.0, 50.0], [75.0, 50.0, 20.0, -20.0]))
    length = across * np.cos(lean) + y * np.sin(lean)
    width = -across * np.sin(lean) + y * np.cos(lean)
    side = 100.0 * (t.points[:, 0] > 0.0)
    hairs = value_noise(np.column_stack([length / 3.2, width / 0.55, side]), seed=seed + 90)
    return body * np.clip(0.80 + 0.5 * hairs, 0.0, 1.0)


def with_brows(paint: Paint, t: Texels, look: Look, *, seed: int) -> Paint:
    """Brows over the skin."""
    hair = Paint.plain(np.tile(np.array(look.hair) * 0.8, (len(t.points), 1)), roughness=0.5, specular=0.035, scatter=0.1)
    return paint.under(hair, 0.85 * brow_share(t, seed=seed))
