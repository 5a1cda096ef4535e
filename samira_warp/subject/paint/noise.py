"""Noise in space: the same at the same place, whatever the atlas."""

from __future__ import annotations

import math

import numpy as np
import torch

from samira_warp.kernels.runtime import launch_range
from samira_warp.subject.paint.noise_kernels import add_octaves, find_spots

GRAIN = 4096
"""Places that are worth a thread."""


def value_noise(points: np.ndarray, *, seed: int) -> np.ndarray:
    """(N,) smooth noise in -1..1 at (N, 3) places; it varies over lengths of about 1."""
    return _octaves(points, 1, seed)


def fractal_noise(points: np.ndarray, *, wavelength: float, octaves: int, seed: int) -> np.ndarray:
    """(N,) sum of noises of halved wavelengths and strengths, about -1..1; lengths in the points' unit."""
    # independent noises add up by their squares
    strength = math.sqrt(sum(0.25**octave for octave in range(octaves)))
    return _octaves(points / wavelength, octaves, seed) / (1.4 * strength)


def spots(points: np.ndarray, *, spacing: float, radius: tuple[float, float], share: float, seed: int) -> np.ndarray:
    """(N,) 0..1: round spots, 1 in their middles, at most one in each cell of a grid.

    Args:
        points: (N, 3) places.
        spacing: Size of a cell.
        radius: Least and greatest radius of a spot, below half the spacing.
        share: Share of cells that hold one.
        seed: Of the spots.
    """
    strengths = torch.empty(len(points))
    launch_range(
        find_spots, len(points), _places(points / spacing), radius[0] / spacing, radius[1] / spacing, share, seed, strengths, grain=GRAIN
    )
    return strengths.numpy().astype(np.float64)


def _octaves(points: np.ndarray, octaves: int, seed: int) -> np.ndarray:
    total = torch.empty(len(points))
    launch_range(add_octaves, len(points), _places(points), octaves, seed, total, grain=GRAIN)
    return total.numpy().astype(np.float64)


def _places(points: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(points, np.float32))
