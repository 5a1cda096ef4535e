"""What light the split-sum terms should see: Monte Carlo in float64, with a standard error.

It reads the panorama itself; nothing here knows of cubemaps, mips or tables. Each integral is sampled by its
lobe and by the light's brightness together (the balance heuristic of Veach, 1997), so that neither a narrow
lobe nor a small sun is missed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

FLOOR = 1e-2
"""Share of the mean brightness that is added to every pixel's chance, so that none is without."""


class Estimate(NamedTuple):
    """A Monte Carlo mean.

    Attributes:
        mean: (P, C) float64.
        error: (P, C) its standard error.
    """

    mean: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class Panorama:
    """An equirectangular light of any even number of columns; its radiance is bilinear between pixel centres.

    Attributes:
        pixels: (H, 2 H, 3) float64 linear radiance.
    """

    pixels: np.ndarray

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """(..., 3) of unit directions (..., 3): ahead (-z) lies the centre, at a quarter to the right +x."""
        column, row = (place - 0.5 for place in self._place(directions))
        i, j = np.floor(column).astype(int), np.floor(row).astype(int)
        x, y = (column - i)[..., None], (row - j)[..., None]
        upper = (1 - x) * self._pixel(j, i) + x * self._pixel(j, i + 1)
        lower = (1 - x) * self._pixel(j + 1, i) + x * self._pixel(j + 1, i + 1)
        return (1 - y) * upper + y * lower

    def density(self, directions: np.ndarray) -> np.ndarray:
        """(...) chance per steradian of `sample`."""
        height, width = self.pixels.shape[:2]
        column, row = self._place(directions)
        chances = self._chances() / self._solid_angles()[:, None]
        return chances[np.clip(row.astype(int), 0, height - 1), column.astype(int) % width]

    def sample(self, count: int, generator: np.random.Generator) -> np.ndarray:
        """(count, 3) directions, by brightness."""
        height, width = self.pixels.shape[:2]
        sums = np.cumsum(self._chances().ravel())
        pixel = np.minimum(
            np.searchsorted(sums, generator.random(count) * sums[-1], side="right"), sums.size - 1
        )
        row, column = pixel // width, pixel % width
        edges = np.cos(np.linspace(0, np.pi, height + 1))
        up = edges[row] + generator.random(count) * (edges[row + 1] - edges[row])
        azimuth = 2 * np.pi * ((column + generator.random(count)) / width - 0.5)
        across = np.sqrt(np.maximum(1 - up * up, 0))
        return np.stack([across * np.sin(azimuth), up, -across * np.cos(azimuth)], axis=-1)

    def _place(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        height, width = self.pixels.shape[:2]
        column = (0.5 + np.arctan2(directions[..., 0], -directions[..., 2]) / (2 * np.pi)) * width
        return column, np.arccos(np.clip(directions[..., 1], -1, 1)) / np.pi * height

    def _pixel(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Pixels, of which the rows over a pole continue on the other side."""
        height, width = self.pixels.shape[:2]
        over = (row < 0) | (row >= height)
        row = np.where(row < 0, -1 - row, np.where(row >= height, 2 * height - 1 - row, row))
        return self.pixels[row, (column + over * (width // 2)) % width]

    def _solid_angles(self) -> np.ndarray:
        height, width = self.pixels.shape[:2]
        edges = np.cos(np.linspace(0, np.pi, height + 1))
        return (edges[:-1] - edges[1:]) * (2 * np.pi / width)

    def _chances(self) -> np.ndarray:
        # interpolation lights up the neighbours of a bright pixel: they share its chance
        height, width = self.pixels.shape[:2]
        rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
        power = np.zeros((height, width))
        for j, i in itertools.product((-1, 0, 1), repeat=2):
            power += self._pixel(rows + j, columns + i).mean(axis=-1)
        chances = (power + FLOOR * power.mean() + np.finfo(float).tiny) * self._solid_angles()[:, None]
        return chances / chances.sum()


def seen_light(
    panorama: Panorama,
    directions: np.ndarray,
    roughness: np.ndarray,
    *,
    samples: int,
    generator: np.random.Generator,
) -> Estimate:
    """E_s about ``directions`` (P, 3) at ``roughness`` (P,).

    It is the mean radiance, weighted by D_GGX(n . h) max(n . l, 0) with v = n. At roughness 1 that is the
    cosine: E_d.
    """
    alpha = (roughness**2)[:, None]

    def distribution(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cosine = np.einsum(
            "pki,pi->pk", np.broadcast_to(light, (len(directions), *light.shape[1:])), directions
        )
        return cosine, alpha**2 / (np.pi * ((1 + cosine) / 2 * (alpha**2 - 1) + 1) ** 2)

    def terms(light: np.ndarray) -> np.ndarray:
        cosine, density = distribution(light)
        value = (
            panorama.radiance(light) * (density * np.maximum(cosine, 0) / _lobe_integral(alpha))[..., None]
        )
        # a half vector drawn by D cos(theta_h) turns the light by twice its angle, over four times the solid
        # angle
        return value / (samples * (density / 4 + panorama.density(light)))[..., None]

    by_lobe = terms(_mirror_lobe(directions, alpha, samples, generator))
    by_light = terms(panorama.sample(samples, generator)[None])
    error = np.sqrt(samples * (by_lobe.var(axis=1) + by_light.var(axis=1)))
    return Estimate(by_lobe.sum(axis=1) + by_light.sum(axis=1), error)


def brdf_terms(
    roughness: np.ndarray, cosine: np.ndarray, *, samples: int, generator: np.random.Generator
) -> Estimate:
    """(P, 2) B_x and B_y of Eq. pbr_color at ``roughness`` and ``cosine`` = n . v, (P,).

    Half vectors are drawn by D cos(theta_h).
    """
    alpha, cosine = (roughness**2)[:, None], cosine[:, None]
    half = _half_vectors(alpha, samples, generator)
    view_half = np.sqrt(1 - cosine**2) * half[..., 0] + cosine * half[..., 2]
    light = 2 * view_half * half[..., 2] - cosine
    lit = (light > 0) & (view_half > 0)
    light = np.where(lit, light, 1.0)
    smith = [np.sqrt(1 + alpha**2 * (1 / x**2 - 1)) for x in (cosine, light)]
    # D G (v . h) / (n . v n . h) over the chance D n . h, with G of Heitz (2014), height-correlated
    reflected = np.where(lit, 2 / (smith[0] + smith[1]) * view_half / (cosine * half[..., 2]), 0.0)
    fresnel = (1 - np.clip(view_half, 0, 1)) ** 5
    values = np.stack([reflected * (1 - fresnel), reflected * fresnel], axis=-1)
    return Estimate(values.mean(axis=1), values.std(axis=1) / np.sqrt(samples))


def _half_vectors(alpha: np.ndarray, samples: int, generator: np.random.Generator) -> np.ndarray:
    """(P, samples, 3) about +z, by D cos(theta_h) for alpha (P, 1)."""
    u, turn = generator.random((len(alpha), samples)), 2 * np.pi * generator.random((len(alpha), samples))
    cosine = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)


def _mirror_lobe(
    directions: np.ndarray, alpha: np.ndarray, samples: int, generator: np.random.Generator
) -> np.ndarray:
    """(P, samples, 3) directions (P, 3) mirrored in half vectors about them."""
    half = _half_vectors(alpha, samples, generator)
    lights = 2 * half[..., 2:] * half - np.array([0.0, 0.0, 1.0])
    other = np.where(np.abs(directions[:, :1]) < 0.5, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    tangent = np.cross(directions, other)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    frames = np.stack([tangent, np.cross(directions, tangent), directions], axis=1)
    return lights @ frames


def _lobe_integral(alpha: np.ndarray) -> np.ndarray:
    """The integral of D max(n . l, 0) over the sphere, with (n . h)^2 = (1 + n . l) / 2."""
    squared = alpha**2
    a, b = (squared + 1) / 2, np.minimum((squared - 1) / 2, -1e-5)
    return np.where(squared > 1 - 2e-5, 1.0, 2 * squared * (np.log1p(b / a) + a / (a + b) - 1) / b**2)
