"""The one-euro filter: little jitter at rest, little lag in motion (Casiez, Roussel and Vogel 2012)."""

from __future__ import annotations

import math

import numpy as np

LEAST_CUTOFF = 1.5
"""Hertz at rest, at a smoothing of 1: jitter of 25 frames a second falls to a half."""

SLOPE = 0.6
"""Hertz that the cutoff rises by for a speed of one unit a second."""

SPEED_CUTOFF = 1.0
"""Hertz of the filter of the speed itself; the paper's."""


class OneEuro:
    """Filters an array over time: a low-pass whose cutoff rises with the speed of each number."""

    def __init__(self, units: np.ndarray, *, smoothing: float = 1.0) -> None:
        """Begin with nothing.

        Args:
            units: (P,) what is a step of each number, as large as its jitter is disturbing.
            smoothing: 0 for none; the cutoff at rest goes with its inverse.
        """
        self._units, self._smoothing = units.astype(np.float64), smoothing
        self._last: tuple[float, np.ndarray, np.ndarray] | None = None

    def __call__(self, seconds: float, values: np.ndarray) -> np.ndarray:
        """The (P,) values at a time, filtered; the first, and what is no later than the last, as they are."""
        if self._smoothing <= 0.0:
            return values
        scaled = values.astype(np.float64) / self._units
        if self._last is None or seconds <= self._last[0]:
            speed = np.zeros_like(scaled)
        else:
            before, last, speed = self._last
            passed = seconds - before
            speed = speed + _share(SPEED_CUTOFF, passed) * ((scaled - last) / passed - speed)
            cutoff = LEAST_CUTOFF / self._smoothing + SLOPE * np.abs(speed)
            scaled = last + _share(cutoff, passed) * (scaled - last)
        self._last = seconds, scaled, speed
        return scaled * self._units

    def forget(self) -> None:
        """Begin anew with the next values."""
        self._last = None


def _share(cutoff: float | np.ndarray, passed: float) -> np.ndarray:
    """How much of a new value counts, by a cutoff in hertz and the seconds since the last one."""
    constant = 1.0 / (2.0 * math.pi * np.asarray(cutoff))
    return np.asarray(1.0 / (1.0 + constant / passed))
