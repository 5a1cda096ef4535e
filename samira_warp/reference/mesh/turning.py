"""The turns of `samira_warp.kernels.mesh.turning` in plain torch: their specification."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.reference.mesh.binding import quaternion_product

SMALL_ANGLE = 1e-4
"""Radians; below it the half-angle sine is taken from its series, so that value and gradient exist at
zero."""


def turn(quaternions: Tensor, turns: Tensor) -> Tensor:
    """See `kernels.mesh.turning.turn`; of any float dtype."""
    return quaternion_product(axis_angle_to_quaternion(turns), quaternions)


def axis_angle_to_quaternion(axis_angle: Tensor) -> Tensor:
    """Unit quaternions (..., 4) w, x, y, z of axis-angle vectors (..., 3), with a gradient at zero."""
    squared = (axis_angle * axis_angle).sum(dim=-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    angle = torch.where(small, torch.ones_like(squared), squared).sqrt()
    cosine = torch.where(small, 1.0 - squared / 8.0, torch.cos(0.5 * angle))
    sine_over_angle = torch.where(small, 0.5 - squared / 48.0, torch.sin(0.5 * angle) / angle)
    return torch.cat([cosine, sine_over_angle * axis_angle], dim=-1)
