"""From sampled residuals to the final Gaussian state (Eqs. offset_process and final_motion)."""

from __future__ import annotations

import torch
from torch import Tensor

POSITION_LIMIT = 0.02
"""Metres, s_mu: more than tracking is wrong by, less than a lip's width."""

SMALL_ANGLE = 1e-4
"""Radians; below it the half-angle sine is taken from its series, so that value and gradient exist at
zero."""


def limit_residual(residual: Tensor) -> tuple[Tensor, Tensor]:
    """Position residual in metres and rotation residual as axis-angle radians, within their limits.

    Args:
        residual: (..., 6) o_mu and o_r.

    Returns:
        (..., 3) s_mu tanh(o_mu) and (..., 3) pi tanh(o_r).
    """
    position, rotation = residual.split(3, dim=-1)
    return limit_position(position), limit_rotation(rotation)


def limit_position(position: Tensor) -> Tensor:
    """(..., 3) metres, s_mu tanh(o_mu)."""
    return POSITION_LIMIT * torch.tanh(position)


def limit_rotation(rotation: Tensor) -> Tensor:
    """(..., 3) axis-angle radians, pi tanh(o_r)."""
    return torch.pi * torch.tanh(rotation)


def axis_angle_to_quaternion(axis_angle: Tensor) -> Tensor:
    """Unit quaternions (..., 4) w, x, y, z of axis-angle vectors (..., 3), with a gradient at zero."""
    squared = (axis_angle * axis_angle).sum(dim=-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    angle = torch.where(small, torch.ones_like(squared), squared).sqrt()
    cosine = torch.where(small, 1.0 - squared / 8.0, torch.cos(0.5 * angle))
    sine_over_angle = torch.where(small, 0.5 - squared / 48.0, torch.sin(0.5 * angle) / angle)
    return torch.cat([cosine, sine_over_angle * axis_angle], dim=-1)


def quaternion_product(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton product (..., 4) of quaternions w, x, y, z: the rotation ``right`` followed by ``left``."""
    a, b, c, d = left.unbind(-1)
    w, x, y, z = right.unbind(-1)
    return torch.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        dim=-1,
    )
