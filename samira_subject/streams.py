"""Random numbers: one seed, and a stream of its own for each thing that draws from it."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What numbers are for; never 0, since numpy takes a seed that ends in zeros for the one without them."""

    IDENTITY = 1
    LOOK = 2
    PERFORMANCE = 3
    RAYS = 4
    ALBEDO = 5
    PAINT = 6
    ORBIT = 7


def generator_of(seed: int, purpose: Purpose, *numbers: int) -> np.random.Generator:
    """A generator that shares no stream with those of another seed, purpose or numbers."""
    return np.random.default_rng(_sequence(seed, purpose, numbers))


def number_of(seed: int, purpose: Purpose, *numbers: int) -> int:
    """Such a stream's first number, 0 to 2^31 - 1: a seed for kernels."""
    return int(_sequence(seed, purpose, numbers).generate_state(1)[0] >> 1)


def _sequence(seed: int, purpose: Purpose, numbers: tuple[int, ...]) -> np.random.SeedSequence:
    return np.random.SeedSequence([seed, *numbers, purpose])
