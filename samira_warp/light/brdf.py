"""The split-sum BRDF table of Eq. pbr_color, integrated here.

GGX with height-correlated Smith shadowing and Schlick's Fresnel: with F = f + (1 - f) (1 - v . h)^5, the
integral of the specular BRDF times n . l over the hemisphere is f B_x + B_y. Both depend on roughness and
n . v only. The table is sampled on nodes, its borders included, so lookups need no clamping at half a texel.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from samira_warp.support.caching import cached_tensors

BRDF_SIZE = 96
"""Nodes along each axis of the table; the error against quadrature is tested to be below 1e-3."""

_POLAR_SAMPLES = 32
_AZIMUTH_SAMPLES = 16
"""Gauss-Legendre samples of the half vector: its angle to the normal in each of two ranges, and its
azimuth."""

_GRAZING = 1e-6
"""n . v and alpha at the table's zero nodes: the limits are finite, 0 / 0 is not."""


@cached_tensors()
def brdf_table(device: torch.device) -> Tensor:
    """(BRDF_SIZE, BRDF_SIZE, 2) float32 (B_x, B_y) by roughness and n . v.

    Row r is a roughness of r / (BRDF_SIZE - 1), column c is n . v = (c / (BRDF_SIZE - 1))^2. The square puts
    nodes where the terms bend: near grazing.
    """
    nodes = np.linspace(0.0, 1.0, BRDF_SIZE)
    rows = [integrate_brdf(roughness, nodes * nodes) for roughness in nodes]
    return torch.from_numpy(np.stack(rows)).to(device, torch.float32)


def integrate_brdf(roughness: np.ndarray | float, cosine: np.ndarray) -> np.ndarray:
    """(..., 2) float64 (B_x, B_y) by quadrature over half vectors.

    ``roughness`` and ``cosine`` = n . v are in [0, 1] and broadcast.

    Half vectors are spaced by the density D (n . h), which leaves 4 V (n . l) (v . h) / (n . h) (F's two
    parts) to average; their azimuth ends where the light sinks below the horizon, so that the integrand is
    smooth between the ends (`_half_angles` sees to the polar ones).
    """
    alpha = np.maximum(np.square(roughness), _GRAZING)[..., None, None]
    cosine = np.clip(cosine, _GRAZING, 1 - _GRAZING)[..., None, None]
    turn, turn_weights = _unit_gauss(_AZIMUTH_SAMPLES)
    # tan(theta_h) = alpha tan(psi) spreads D (n . h) dOmega_h as 2 sin(psi) cos(psi) dpsi dphi / (2 pi), with
    # no root at either end.
    psi, weights = _half_angles(alpha, cosine)
    density = weights * np.sin(2 * psi)
    length = np.sqrt(np.cos(psi) ** 2 + (alpha * np.sin(psi)) ** 2)
    half_z, half_x = np.cos(psi) / length, alpha * np.sin(psi) / length
    view_x = np.sqrt(1 - cosine**2)
    # n . l = 2 (v . h)(n . h) - n . v is above 0 within this azimuth.
    limit = np.arccos(np.clip((cosine / (2 * half_z) - cosine * half_z) / (view_x * half_x), -1, 1))
    view_half = view_x * half_x * np.cos(turn * limit) + cosine * half_z
    light_z = np.clip(2 * view_half * half_z - cosine, 0, 1)
    shadowing = light_z * np.sqrt(cosine**2 * (1 - alpha**2) + alpha**2) + cosine * np.sqrt(
        light_z**2 * (1 - alpha**2) + alpha**2
    )
    average = density * turn_weights * (limit / np.pi) * 2 * light_z * view_half / (half_z * shadowing)
    schlick = np.maximum(1 - view_half, 0) ** 5
    return np.stack(
        [(average * (1 - schlick)).sum(axis=(-2, -1)), (average * schlick).sum(axis=(-2, -1))], axis=-1
    )


def _half_angles(alpha: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 2 samples, 1) psi and weights, in the two ranges that the horizon makes.

    The light turns by twice as much as the half vector: with the view at theta_v it stays above the horizon
    at every azimuth up to theta_h = 45 degrees - theta_v / 2, at some up to 45 degrees + theta_v / 2, and at
    none after that. In the second range the limit of the azimuth starts and ends like a root, which samples
    spaced like a cosine undo.
    """
    points, weights = (values[:, None] for values in _unit_gauss(_POLAR_SAMPLES))
    tilt = np.arccos(cosine) / 2
    first, last = (np.arctan(np.tan(np.pi / 4 + side * tilt) / alpha) for side in (-1, 1))
    psi = np.concatenate([first * points, first + (last - first) * (1 - np.cos(np.pi * points)) / 2], axis=-2)
    return psi, np.concatenate(
        [first * weights, (last - first) * (np.pi / 2) * np.sin(np.pi * points) * weights], axis=-2
    )


def _unit_gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre points and weights on [0, 1]."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2
