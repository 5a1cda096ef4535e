"""Light as nine spherical harmonics, which is all that a matte surface tells of it.

Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps, 2001.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_COSINE = (math.pi, 2 * math.pi / 3, math.pi / 4)
"""Coefficients of the clamped cosine, by degree."""

FUNCTIONS = 9


def harmonics(directions: Tensor) -> Tensor:
    """(..., 9) real spherical harmonics up to degree two of (..., 3) unit directions, orthonormal."""
    x, y, z = directions.unbind(dim=-1)
    zero, one = 0.5 / math.sqrt(math.pi), math.sqrt(3 / (4 * math.pi))
    two = 0.5 * math.sqrt(15 / math.pi)
    return torch.stack(
        [
            torch.full_like(x, zero),
            one * y,
            one * z,
            one * x,
            two * x * y,
            two * y * z,
            0.25 * math.sqrt(5 / math.pi) * (3 * z * z - 1),
            two * x * z,
            0.5 * two * (x * x - y * y),
        ],
        dim=-1,
    )


def irradiance_functions(normals: Tensor) -> Tensor:
    """(..., 9) irradiance over pi at (..., 3) unit normals, of radiance that is one harmonic each.

    Uniform radiance of 1, which is 2 sqrt(pi) of the first harmonic, gives 1.
    """
    degrees = torch.tensor(
        [_COSINE[0], *[_COSINE[1]] * 3, *[_COSINE[2]] * 5], dtype=normals.dtype, device=normals.device
    )
    return harmonics(normals) * degrees / math.pi


def uniform(radiance: Tensor) -> Tensor:
    """(9, C) harmonics of a light of (C,) radiance from everywhere."""
    light = radiance.new_zeros(FUNCTIONS, len(radiance))
    light[0] = 2 * math.sqrt(math.pi) * radiance
    return light
