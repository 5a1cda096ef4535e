"""Eyeballs, teeth and what lines the mouth."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.eyes import EYE, EYE_RADIUS, IRIS_RADIUS
from samira_subject.anatomy.rings import fade
from samira_subject.paint.layer import Paint, mix
from samira_subject.paint.look import Look
from samira_subject.paint.noise import fractal_noise, value_noise
from samira_subject.paint.texels import Texels

PUPIL_RADIUS = 2.1
"""Millimetres, in a bright room."""


def eye_paint(t: Texels, look: Look, *, seed: int) -> Paint:
    """White, iris and pupil under one wet coat, as if all of the head were eyeballs."""
    offset = t.on_left() - EYE
    radius = np.where(offset[:, 2] > 0.0, np.hypot(offset[:, 0], offset[:, 1]), EYE_RADIUS)
    turn = np.arctan2(offset[:, 1], offset[:, 0])
    redness = fade(EYE_RADIUS - np.abs(offset[:, 0]), 1.0, 7.0)
    veins = np.clip(
        1.0 - 6.0 * np.abs(fractal_noise(t.points, wavelength=4.0, octaves=3, seed=seed, field="veins")),
        0.0,
        1.0,
    )
    white = np.array([0.66, 0.62, 0.58]) * np.power(
        np.array([0.97, 0.80, 0.78]), (0.7 * redness + 0.35 * veins * redness)[:, None]
    )
    place = np.clip((radius - PUPIL_RADIUS) / (IRIS_RADIUS - PUPIL_RADIUS), 0.0, 1.0)
    circle = np.column_stack(
        [5.0 * np.cos(turn), 5.0 * np.sin(turn), 0.25 * radius + 40.0 * (t.points[:, 0] > 0.0)]
    )
    fibres = fractal_noise(circle, wavelength=0.7, octaves=3, seed=seed, field="iris fibres")
    warm = np.exp(-(((place - 0.12) / 0.16)[:, None] ** 2)) * np.array([0.07, 0.03, -0.01])
    iris = (
        (np.array(look.iris) + warm)
        * (1.0 + 0.45 * fibres)[:, None]
        * (1.0 - 0.75 * (1.0 - fade(place, 0.72, 1.0)))[:, None]
    )
    colour = mix(
        white, np.maximum(iris, 0.004), fade(radius, IRIS_RADIUS - 0.25, IRIS_RADIUS + 0.45)[:, None]
    )
    colour = mix(
        colour, np.full_like(colour, 0.003), fade(radius, PUPIL_RADIUS - 0.25, PUPIL_RADIUS + 0.2)[:, None]
    )
    return Paint.plain(colour, roughness=0.1, specular=0.028, scatter=0.0)


def teeth_paint(t: Texels, *, seed: int) -> Paint:
    """Enamel, darker between teeth and towards the gum, and the gum itself."""
    count, height = t.tooth.T
    between = np.abs(count - np.round(count))
    gap = fade(between, 0.02, 0.09) * fade(-height, -0.05, 0.05) * 0.75
    cloud = 0.03 * value_noise(t.points / 2.0, seed=seed, field="enamel")
    enamel = (
        np.array([0.76, 0.70, 0.57]) * ((1.0 - 0.12 * fade(height, 0.0, 0.6) + cloud) * (1.0 - gap))[:, None]
    )
    # gums reach down between the teeth
    line = 0.10 - 0.16 * fade(between, 0.0, 0.25)
    gum = (
        np.array([0.48, 0.19, 0.17])
        * (1.0 + 0.1 * value_noise(t.points / 1.5, seed=seed, field="gum"))[:, None]
    )
    share = fade(height + line, -0.06, 0.06)
    return Paint.plain(mix(enamel, gum, share[:, None]), roughness=0.22, specular=0.04, scatter=0.3)


def mouth_paint(t: Texels, *, seed: int) -> Paint:
    """Mucosa: red, darker with depth."""
    shade = (1.0 - 0.6 * np.clip(1.3 * t.cavity, 0.0, 1.0)) * (
        1.0 + 0.12 * fractal_noise(t.points, wavelength=5.0, octaves=2, seed=seed, field="mucosa")
    )
    return Paint.plain(
        np.array([0.50, 0.17, 0.15]) * shade[:, None], roughness=0.3, specular=0.03, scatter=0.5
    )


def tongue_paint(t: Texels, *, seed: int) -> Paint:
    """A rough, pale red."""
    grain = 1.0 + 0.15 * value_noise(t.points / 0.9, seed=seed, field="tongue")
    return Paint.plain(
        np.array([0.55, 0.24, 0.22]) * grain[:, None], roughness=0.4, specular=0.03, scatter=0.7
    )
