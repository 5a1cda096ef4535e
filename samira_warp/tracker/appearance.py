"""Albedo of points and one light, from what frames show of them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.light.harmonics import FUNCTIONS, irradiance_functions, uniform_harmonics

TURNS = 6
"""Rounds of albedo for a light, and light for an albedo: each is a linear least squares."""

RIDGE = 1e-2
"""Pull of the light's harmonics but the first towards zero, in what the pictures say of the first."""

DARKEST = 0.05
"""Least irradiance, as a share of the mean, that albedo is divided by."""


class Appearance(NamedTuple):
    """Colours of points.

    Attributes:
        albedo: (S, 3) linear; its scale and the light's are one, until something else tells them apart.
        light: (9, 3) radiance in spherical harmonics of the world.
    """

    albedo: Tensor
    light: Tensor

    def shade(self, normals: Tensor) -> Tensor:
        """(N, S, 3) linear colours of the points with (N, S, 3) unit normals."""
        return self.albedo * self.irradiance(normals)

    def irradiance(self, normals: Tensor) -> Tensor:
        """(N, S, 3) irradiance over pi, positive."""
        floor = DARKEST * self.light[0] * 0.28
        return (irradiance_functions(normals) @ self.light).maximum(floor)


def estimate(colors: Tensor, weights: Tensor, normals: Tensor) -> Appearance:
    """Split what is seen into albedo and light by alternating least squares.

    The light's mean is the one that gives the points a mean albedo of a half.

    Args:
        colors: (N, S, 3) linear.
        weights: (N, S), 0 where a point is not seen.
        normals: (N, S, 3) unit, in the world.
    """
    functions = irradiance_functions(normals)
    seen = weights.sum(dim=0) > 0
    mean = (weights[..., None] * colors).sum(dim=(0, 1)) / weights.sum().clamp(min=1e-9)
    appearance = Appearance(torch.full_like(colors[0], 0.5), uniform_harmonics(2.0 * mean))
    for _ in range(TURNS):
        irradiance = appearance.irradiance(normals)
        top = (weights[..., None] * irradiance * colors).sum(dim=0)
        bottom = (weights[..., None] * irradiance.square()).sum(dim=0)
        albedo = top / bottom.clamp(min=1e-9)
        typical = albedo[seen].mean(dim=0) if bool(seen.any()) else albedo.new_full((3,), 0.5)
        albedo = torch.where(seen[:, None], albedo / typical * 0.5, 0.5)
        appearance = Appearance(albedo, _light(functions, colors, weights, albedo))
    return appearance


def _light(functions: Tensor, colors: Tensor, weights: Tensor, albedo: Tensor) -> Tensor:
    """(9, 3) harmonics of the light that explains the colours."""
    result = colors.new_zeros(FUNCTIONS, 3)
    for channel in range(3):
        rows = functions * albedo[:, channel, None]
        weighted = rows * weights[..., None]
        matrix = torch.einsum("nsa,nsb->ab", weighted, rows).double()
        right = torch.einsum("nsa,ns->a", weighted, colors[..., channel]).double()
        ridge = torch.full((FUNCTIONS,), float(RIDGE * matrix[0, 0]), dtype=torch.float64)
        ridge[0] = 1e-9 * matrix[0, 0] + 1e-12
        result[:, channel] = torch.linalg.solve(matrix + torch.diag(ridge), right).to(colors.dtype)
    return result
