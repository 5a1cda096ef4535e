"""Noise in space: the same at the same place, whatever the atlas."""

from __future__ import annotations

import math
import zlib

import numpy as np
import torch
from torch import Tensor

from samira_subject.paint.noise_kernels import add_octaves, find_spots
from samira_subject.streams import Purpose, number_of
from samira_warp.kernels.runtime import launch_range

GRAIN = 4096
"""Places that are worth a thread."""


def value_noise(points: np.ndarray, *, seed: int, field: str) -> np.ndarray:
    """(N,) smooth noise in -1..1 at (N, 3) places, which varies over lengths of about 1.

    Each person's every ``field`` is its own.
    """
    return _octaves(points, 1, seed, field)


def fractal_noise(
    points: np.ndarray, *, wavelength: float, octaves: int, seed: int, field: str
) -> np.ndarray:
    """(N,) sum of noises of halved wavelengths and strengths, about -1..1; lengths in the points' unit."""
    # independent noises add up by their squares
    strength = math.sqrt(sum(0.25**octave for octave in range(octaves)))
    return _octaves(points / wavelength, octaves, seed, field) / (1.4 * strength)


def spots(
    points: np.ndarray, *, spacing: float, radius: tuple[float, float], share: float, seed: int, field: str
) -> np.ndarray:
    """(N,) 0..1: round spots, 1 in their middles, at most one in each cell of a grid.

    Args:
        points: (N, 3) places.
        spacing: Size of a cell.
        radius: Least and greatest radius of a spot, below half the spacing.
        share: Share of cells that hold one.
        seed: Whose spots.
        field: Which of this person's.
    """
    strengths = torch.empty(len(points))
    least, greatest = radius[0] / spacing, radius[1] / spacing
    launch_range(
        find_spots,
        len(points),
        _places(points / spacing),
        least,
        greatest,
        share,
        _field_seed(seed, field),
        strengths,
        grain=GRAIN,
    )
    return strengths.numpy().astype(np.float64)


def _octaves(points: np.ndarray, octaves: int, seed: int, field: str) -> np.ndarray:
    total = torch.empty(len(points))
    launch_range(
        add_octaves, len(points), _places(points), octaves, _field_seed(seed, field), total, grain=GRAIN
    )
    return total.numpy().astype(np.float64)


def _places(points: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(points, np.float32))


def _field_seed(seed: int, field: str) -> int:
    return number_of(seed, Purpose.PAINT, zlib.crc32(field.encode()))
