"""Hair: a close crop on the scalp, and brows."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.masks import hairline
from samira_subject.anatomy.rings import fade
from samira_subject.paint.layer import Paint
from samira_subject.paint.look import Look
from samira_subject.paint.noise import fractal_noise, value_noise
from samira_subject.paint.texels import Texels

BROW = (
    (11.0, 15.5, 4.0),
    (18.0, 18.0, 4.3),
    (28.0, 20.5, 3.9),
    (37.0, 21.5, 3.0),
    (45.0, 18.5, 2.1),
    (52.0, 13.0, 0.9),
)
"""Middle of the brow in front view and its half height, millimetres, from the nose outwards."""


def scalp_share(t: Texels, *, seed: int) -> np.ndarray:
    """(N,) how dense the crop is: full on the scalp, thinning over two centimetres at its edge."""
    edge = hairline(t.points) + 5.0 * fractal_noise(
        t.points, wavelength=11.0, octaves=4, seed=seed, field="hairline"
    )
    return (1.0 - fade(edge, -5.0, 13.0)) * t.is_part("skin")


def with_scalp(paint: Paint, t: Texels, look: Look, share: np.ndarray, *, seed: int) -> Paint:
    """Cropped hair where `scalp_share` says, streaked along the way it lies."""
    streaks = value_noise(t.points * (0.55, 0.13, 0.55), seed=seed, field="hair streaks")
    grain = value_noise(t.points / 0.9, seed=seed, field="hair grain")
    colour = np.array(look.hair) * np.exp(0.21 * streaks + 0.18 * grain)[:, None]
    crop = Paint.plain(colour, roughness=0.72, specular=0.028, scatter=0.0)
    thin = np.clip(
        value_noise(t.points / 0.8, seed=seed, field="hair density") * 0.9 + 2.4 * share - 0.7, 0.0, 1.0
    )
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
    hairs = value_noise(np.column_stack([length / 3.2, width / 0.55, side]), seed=seed, field="brow hairs")
    return body * np.clip(0.80 + 0.5 * hairs, 0.0, 1.0)


def with_brows(paint: Paint, look: Look, share: np.ndarray) -> Paint:
    """Brows over the skin where `brow_share` says."""
    hair = Paint.plain(
        np.tile(np.array(look.hair) * 0.8, (len(share), 1)), roughness=0.5, specular=0.035, scatter=0.1
    )
    return paint.under(hair, 0.85 * share)
