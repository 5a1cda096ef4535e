"""The split-sum BRDF table of Eq. pbr_color: GGX with height-correlated Smith shadowing and Schlick's Fresnel, integrated here.

With F = f + (1 - f) (1 - v . h)^5, the integral of the specular BRDF times n . l over the hemisphere is f B_x + B_y. Both depend on
roughness and n . v only. The table is sampled on nodes, its borders included, so lookups need no clamping at half a texel.
"""

from __future__ import annotations

import functools

import numpy as np
import torch

BRDF_SIZE = 96
"""Nodes along each axis of the table; the error against quadrature is tested to be below 1e-3."""

_POLAR_SAMPLES = 48
_AZIMUTH_SAMPLES = 16
"""Gauss-Legendre samples of the half vector."""

_GRAZING = 1e-6
"""n . v and alpha at the table's zero nodes: the limits are finite, 0 / 0 is not."""


@functools.cache
def brdf_table(device: torch.device) -> torch.Tensor:
    """(BRDF_SIZE, BRDF_SIZE, 2) float32 (B_x, B_y) at roughness row / (BRDF_SIZE - 1) and n . v = (column / (BRDF_SIZE - 1))^2.

    The square puts nodes where the terms bend: near grazing.
    """
    nodes = torch.linspace(0.0, 1.0, BRDF_SIZE, dtype=torch.float64)
    rows = [integrate_brdf(roughness.expand(BRDF_SIZE), nodes * nodes) for roughness in nodes]
    return torch.stack(rows).to(device, torch.float32)


def integrate_brdf(roughness: torch.Tensor, cosine: torch.Tensor) -> torch.Tensor:
    """(..., 2) float64 (B_x, B_y) by quadrature over half vectors, for float64 ``roughness`` and ``cosine`` = n . v, both (...) in [0, 1].

    Half vectors are spaced by the density D (n . h), which leaves 4 V (n . l) (v . h) / (n . h) (F's two parts) to average; their azimuth
    ends where the light sinks below the horizon, so that the integrand is smooth between the ends.
    """
    alpha = (roughness * roughness).clamp(min=_GRAZING)[..., None, None]
    cosine = cosine.clamp(_GRAZING, 1 - _GRAZING)[..., None, None]
    polar, polar_weights = (torch.from_numpy(part)[:, None] for part in _unit_gauss(_POLAR_SAMPLES))
    turn, turn_weights = (torch.from_numpy(part) for part in _unit_gauss(_AZIMUTH_SAMPLES))
    # tan(theta_h) = alpha tan(psi) spreads D (n . h) dOmega_h as 2 sin(psi) cos(psi) dpsi dphi / (2 pi), with no root at either end.
    psi = polar * (torch.pi / 2)
    density = polar_weights * (torch.pi / 2) * torch.sin(2 * psi)
    length = torch.sqrt(torch.cos(psi) ** 2 + (alpha * torch.sin(psi)) ** 2)
    half_z, half_x = torch.cos(psi) / length, alpha * torch.sin(psi) / length
    view_x = torch.sqrt(1 - cosine**2)
    # n . l = 2 (v . h)(n . h) - n . v is above 0 within this azimuth.
    limit = torch.acos(((cosine / (2 * half_z) - cosine * half_z) / (view_x * half_x)).clamp(-1, 1))
    view_half = view_x * half_x * torch.cos(turn * limit) + cosine * half_z
    light_z = (2 * view_half * half_z - cosine).clamp(0, 1)
    shadowing = light_z * torch.sqrt(cosine**2 * (1 - alpha**2) + alpha**2) + cosine * torch.sqrt(light_z**2 * (1 - alpha**2) + alpha**2)
    average = density * turn_weights * (limit / torch.pi) * 2 * light_z * view_half / (half_z * shadowing)
    schlick = (1 - view_half).clamp(min=0) ** 5
    return torch.stack([(average * (1 - schlick)).sum(dim=(-2, -1)), (average * schlick).sum(dim=(-2, -1))], dim=-1)


def _unit_gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre points and weights on [0, 1]."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2


def lookup_brdf(roughness: torch.Tensor, cosine: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """B_x and B_y, each (M,), bilinear in the table.

    Differentiable in ``roughness`` and ``cosine`` = n . v, both (M,) floats that are clamped to [0, 1].
    """
    table = brdf_table(roughness.device).to(roughness.dtype).view(-1, 2)
    last = BRDF_SIZE - 1
    x = torch.sqrt(cosine.clamp(_GRAZING, 1.0)) * last
    y = roughness.clamp(0.0, 1.0) * last
    column = x.detach().long().clamp(max=last - 1)
    row = y.detach().long().clamp(max=last - 1)
    x, y = (x - column)[:, None], (y - row)[:, None]
    first = row * BRDF_SIZE + column
    upper = table[first] * (1 - x) + table[first + 1] * x
    lower = table[first + BRDF_SIZE] * (1 - x) + table[first + BRDF_SIZE + 1] * x
    terms = upper * (1 - y) + lower * y
    return terms[:, 0], terms[:, 1]
