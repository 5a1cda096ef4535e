"""What distinguishes people's surfaces, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from samira_subject.streams import Purpose, generator_of

Colour = tuple[float, float, float]
"""Linear."""

SKIN: tuple[Colour, ...] = (
    (0.60, 0.40, 0.31),
    (0.53, 0.335, 0.245),
    (0.42, 0.245, 0.16),
    (0.27, 0.145, 0.085),
    (0.15, 0.078, 0.047),
)
"""Diffuse reflectance of skin from pale to dark, as spectrophotometers find it on foreheads."""

IRIS: tuple[Colour, ...] = (
    (0.13, 0.20, 0.26),
    (0.16, 0.19, 0.13),
    (0.15, 0.085, 0.035),
    (0.055, 0.024, 0.010),
)
"""Blue-grey, green, hazel, brown."""

HAIR: tuple[Colour, ...] = (
    (0.13, 0.075, 0.035),
    (0.038, 0.022, 0.013),
    (0.020, 0.014, 0.011),
    (0.17, 0.16, 0.15),
)
"""Fair, brown, black, grey."""


@dataclass(frozen=True)
class Look:
    """A person's colours.

    Attributes:
        skin: Of the forehead.
        iris: Middle of the iris.
        hair: Scalp, brows, lashes and beard.
        beard: 0 for none to 1 for a dense shadow.
        freckles: 0 for none to 1 for many.
    """

    skin: Colour
    iris: Colour
    hair: Colour
    beard: float
    freckles: float


FIRST = Look(skin=(0.60, 0.375, 0.265), iris=(0.14, 0.185, 0.19), hair=HAIR[1], beard=0.28, freckles=0.45)
"""The person with seed 0."""


def look_of(seed: int) -> Look:
    """A person's colours: dark skin comes with dark eyes and hair."""
    if seed == 0:
        return FIRST
    generator = generator_of(seed, Purpose.LOOK)
    tone = generator.uniform(0.0, len(SKIN) - 1.0)
    darkness = tone / (len(SKIN) - 1.0)
    beard = generator.uniform(0.2, 0.8) if generator.random() < 0.5 else 0.0
    return Look(
        skin=_between(SKIN, tone),
        iris=_between(IRIS, np.clip(3.2 * darkness + generator.uniform(0.0, 1.5), 0.0, 3.0)),
        hair=_between(HAIR[:3], np.clip(1.6 * darkness + generator.uniform(0.2, 1.2), 0.0, 2.0))
        if generator.random() < 0.9
        else HAIR[3],
        beard=float(beard),
        freckles=float(max(0.0, generator.uniform(-0.5, 1.0)) * (1.0 - darkness)),
    )


def _between(colours: tuple[Colour, ...], place: float) -> Colour:
    """A colour between two neighbours of a row, mixed as reflectances multiply."""
    index = min(int(place), len(colours) - 2)
    mixed = np.exp(
        (1.0 - place + index) * np.log(colours[index]) + (place - index) * np.log(colours[index + 1])
    )
    return (float(mixed[0]), float(mixed[1]), float(mixed[2]))
