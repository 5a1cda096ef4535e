"""Light as nine spherical harmonics, which is all that a matte surface tells of it.

Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps, 2001.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

FUNCTIONS = 9
"""Real spherical harmonics up to degree two: 1; y, z, x; xy, yz, 3 z^2 - 1, xz, x^2 - y^2."""

_COSINE = (math.pi, 2.0 * math.pi / 3.0, math.pi / 4.0)
"""Coefficients of the clamped cosine, by degree."""

_DEGREES = (0, 1, 1, 1, 2, 2, 2, 2, 2)


def harmonics(directions: Tensor) -> Tensor:
    """(..., 9) real spherical harmonics, orthonormal, of (..., 3) unit directions."""
    x, y, z = directions.unbind(dim=-1)
    zero, one = 0.5 / math.sqrt(math.pi), math.sqrt(3.0 / (4.0 * math.pi))
    two = 0.5 * math.sqrt(15.0 / math.pi)
    return torch.stack(
        [
            torch.full_like(x, zero),
            one * y,
            one * z,
            one * x,
            two * x * y,
            two * y * z,
            0.25 * math.sqrt(5.0 / math.pi) * (3.0 * z * z - 1.0),
            two * x * z,
            0.5 * two * (x * x - y * y),
        ],
        dim=-1,
    )


def irradiance_functions(normals: Tensor) -> Tensor:
    """(..., 9) cosine-weighted mean radiance, irradiance over pi, about (..., 3) unit normals.

    Each is that of a light whose radiance is one of the harmonics: times a light's (9, C) coefficients, E_d.
    """
    degrees = normals.new_tensor([_COSINE[degree] / math.pi for degree in _DEGREES])
    return harmonics(normals) * degrees


def mean_radiance(light: Tensor) -> Tensor:
    """(C,) mean over all directions of the radiance of a light of (9, C) coefficients."""
    return light[0] * (0.5 / math.sqrt(math.pi))


def uniform_harmonics(radiance: Tensor) -> Tensor:
    """(9, C) harmonics of a light of (C,) radiance from everywhere: E_d is the radiance."""
    light = radiance.new_zeros(FUNCTIONS, len(radiance))
    light[0] = 2.0 * math.sqrt(math.pi) * radiance
    return light
