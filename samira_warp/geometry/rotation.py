"""Axis-angle vectors as rotation matrices."""

from __future__ import annotations

import torch
from torch import Tensor


def axis_angle_to_matrix(axis_angle: Tensor) -> Tensor:
    """Rodrigues' formula, exact and smooth at zero.

    Args:
        axis_angle: (..., 3) axis times angle in radians.

    Returns:
        (..., 3, 3) rotations R = 1 + a [w] + b [w]^2 with a = sin(t) / t, b = (1 - cos(t)) / t^2 and t = |w|.
    """
    squared = (axis_angle * axis_angle).sum(dim=-1)
    small = squared < 1e-4
    angle = torch.where(small, 1.0, squared).sqrt()
    sine = torch.where(small, 1 - squared / 6 + squared**2 / 120, angle.sin() / angle)
    versine = torch.where(small, 0.5 - squared / 24 + squared**2 / 720, 2 * ((angle / 2).sin() / angle) ** 2)
    x, y, z = axis_angle.unbind(dim=-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + sine[..., None, None] * cross + versine[..., None, None] * (cross @ cross)
