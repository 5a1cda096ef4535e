"""Skin: blood under it, sun on it, freckles, lips, the lids' edges, a beard's shadow."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.rings import fade
from samira_subject.paint.layer import Paint
from samira_subject.paint.look import Look
from samira_subject.paint.noise import fractal_noise, spots, value_noise
from samira_subject.paint.texels import Texels

BLOOD = np.array([1.06, 0.80, 0.78])
"""Factor on skin where blood lies close below it."""

MELANIN = np.array([0.78, 0.66, 0.55])
"""Factor on skin where it is browner by one step."""

LIP = np.array([0.86, 0.50, 0.50])
"""Factor from a person's skin to the lips."""

FLUSHED = (
    ((37.0, -30.0, 12.0), 19.0, 0.75),
    ((0.0, -35.0, 43.0), 11.0, 0.8),
    ((16.0, -39.0, 25.0), 8.0, 0.7),
    ((0.0, -100.0, 26.0), 15.0, 0.35),
    ((20.0, -4.0, 8.0), 7.0, 0.5),
    ((0.0, 20.0, 24.0), 14.0, 0.2),
)
"""Where blood shows: middle, millimetres of reach, strength; both sides."""


def skin_paint(t: Texels, look: Look, *, seed: int) -> Paint:
    """Skin over all texels, as if all of the head were skin."""
    points = t.points
    mottle = fractal_noise(points, wavelength=9.0, octaves=4, seed=seed, field="mottle")
    blood = 0.16 * fractal_noise(points, wavelength=16.0, octaves=3, seed=seed, field="blood")
    on_left = t.on_left()
    for middle, reach, strength in FLUSHED:
        blood += strength * np.exp(-((on_left - middle) ** 2).sum(axis=1) / reach**2)
    blood += 0.55 * t.is_part("left_ear", "right_ear")
    shade = 0.5 * np.exp(-((((on_left - (27.0, -11.0, 8.0)) / (11.0, 5.0, 12.0)) ** 2).sum(axis=1)))
    colour = (
        np.array(look.skin)
        * np.power(BLOOD, blood[:, None])
        * np.power(MELANIN, (0.5 * shade + 0.12 * mottle)[:, None])
    )
    colour = colour * (1.0 + 0.035 * value_noise(points / 1.1, seed=seed, field="grain"))[:, None]
    paint = Paint.plain(colour, roughness=0.46, specular=0.028, scatter=1.0)
    oily = (
        np.exp(-((points[:, 0] / 16.0) ** 2))
        * (1.0 - fade(points[:, 1], -60.0, -40.0))
        * (points[:, 2] > 0.0)
    )
    roughness = paint.roughness - 0.08 * oily + 0.04 * mottle
    return Paint(paint.albedo, roughness, paint.specular + 0.006 * oily, paint.scatter)


def with_nostrils(paint: Paint, t: Texels) -> Paint:
    """The dark within the nostrils, deeper than their dents are."""
    on_left = t.on_left()
    start, along = np.array([6.2, -42.8, 30.0]), np.array([4.0, 0.4, -3.0])
    share = np.clip(((on_left - start) * along).sum(axis=1) / (along**2).sum(), 0.0, 1.0)
    distance = np.linalg.norm(on_left - start - share[:, None] * along, axis=1)
    inside = fade(distance, 1.0, 3.2) * t.is_part("skin")
    return paint.tinted(np.power(np.array([0.22, 0.12, 0.11]), inside[:, None]))


def with_freckles(paint: Paint, t: Texels, look: Look, *, seed: int) -> Paint:
    """Freckles over cheeks and nose, and a few moles anywhere."""
    points = t.points
    sunny = np.exp(-(((np.abs(points[:, 0]) - 22.0) / 22.0) ** 2) - ((points[:, 1] + 22.0) / 15.0) ** 2) * (
        points[:, 2] > -20.0
    )
    many = spots(points, spacing=3.4, radius=(0.35, 0.95), share=0.55, seed=seed, field="freckles")
    few = spots(points, spacing=34.0, radius=(0.7, 1.3), share=0.22, seed=seed, field="moles")
    strength = 0.9 * look.freckles * np.clip(1.6 * sunny + 0.05, 0.0, 1.0) * many + 2.0 * few * t.is_part(
        "skin"
    )
    return paint.tinted(np.power(MELANIN, strength[:, None]))


def with_lips(paint: Paint, t: Texels, look: Look, *, seed: int) -> Paint:
    """The vermilion, with its fine upright lines, darker where the lips meet."""
    wobble = 0.35 * value_noise(t.points / 1.7, seed=seed, field="lip border")
    share = fade(t.lip + wobble, -0.9, 0.5) * t.is_part("skin", "mouth")
    lines = value_noise(t.points * (1.15, 0.16, 0.3), seed=seed, field="lip lines")
    deep = fade(t.lip, -9.0, -4.5)
    colour = np.array(look.skin) * LIP * (1.0 + 0.09 * lines - 0.22 * deep)[:, None]
    wet = Paint.plain(colour, roughness=0.34, specular=0.032, scatter=0.8)
    return paint.under(wet, share)


def with_beard(paint: Paint, t: Texels, look: Look, *, seed: int) -> Paint:
    """Stubble on lip, chin, jaw and upper neck: grey-blue as a whole, dark in points."""
    if look.beard == 0.0:
        return paint
    x, y, z = t.points.T
    upper = np.interp(
        -z, [-31.0, -22.0, -12.0, 5.0, 35.0, 62.0, 72.0], [-49.0, -50.0, -58.0, -57.0, -44.0, -18.0, 5.0]
    )
    grows = fade(
        y + 3.0 * value_noise(t.points / 9.0, seed=seed, field="beard edge"), upper - 5.0, upper + 3.0
    ) * fade(-y, 116.0, 142.0)
    grows *= fade(-z, 66.0, 78.0) * (1.0 - fade(t.lip, 0.5, 2.2)) * t.is_part("skin")
    # bare beside the lower lip's middle, thin on the cheeks
    bare = np.exp(-(((np.abs(x) - 15.0) / 6.0) ** 2) - ((y + 79.0) / 4.0) ** 2)
    grows *= (1.0 - 0.7 * bare) * (0.55 + 0.45 * fade(np.abs(x), 20.0, 50.0))
    points = np.clip(value_noise(t.points / 0.75, seed=seed, field="stubble") * 1.6 - 0.2, 0.0, 1.0)
    share = look.beard * grows * (0.38 + 0.5 * points)
    hair = Paint.plain(
        np.tile(np.array(look.hair) * 0.9 + (0.0, 0.004, 0.01), (len(x), 1)),
        roughness=0.55,
        specular=0.03,
        scatter=0.6,
    )
    return paint.under(hair, np.clip(share, 0.0, 1.0))


def with_lid_edges(paint: Paint, t: Texels, look: Look) -> Paint:
    """The moist lining of the lids, and the lashes as the dark band that they are from afar."""
    near_eye = t.lid < 20.0
    lining = Paint.plain(
        np.tile(np.array(look.skin) * (0.95, 0.62, 0.60), (len(t.lid), 1)),
        roughness=0.25,
        specular=0.03,
        scatter=0.8,
    )
    paint = paint.under(lining, fade(t.lid, -0.9, -0.2) * near_eye)
    upper = t.turn > 0.0
    arch = np.clip(np.abs(np.sin(t.turn)) * 2.2, 0.0, 1.0)
    lash = (
        np.where(
            upper,
            0.9 * fade(np.abs(t.lid - 0.1), 0.35, 1.15) * arch,
            0.35 * fade(np.abs(t.lid - 0.3), 0.2, 0.8) * arch,
        )
        * near_eye
    )
    dark = Paint.plain(
        np.tile(np.array(look.hair) * 0.5, (len(t.lid), 1)), roughness=0.5, specular=0.03, scatter=0.2
    )
    pigment = np.power(MELANIN, (0.5 * upper * fade(t.lid, 2.0, 8.0) * near_eye)[:, None])
    return paint.tinted(pigment).under(dark, lash)
