"""Axis-angle vectors as rotation matrices, and how these turn with them."""

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
    cross = _cross(axis_angle)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + sine[..., None, None] * cross + versine[..., None, None] * (cross @ cross)


def left_jacobian(axis_angle: Tensor) -> Tensor:
    """How a rotation turns with its axis-angle vector v: R(v + d) = exp(J d) R(v) for small d.

    Args:
        axis_angle: (..., 3) axis times angle in radians.

    Returns:
        (..., 3, 3) J = 1 + b [v] + c [v]^2 with b = (1 - cos(t)) / t^2, c = (t - sin(t)) / t^3 and t = |v|.
    """
    squared = (axis_angle * axis_angle).sum(dim=-1)
    small = squared < 1e-4
    angle = torch.where(small, 1.0, squared).sqrt()
    versine = torch.where(small, 0.5 - squared / 24 + squared**2 / 720, 2 * ((angle / 2).sin() / angle) ** 2)
    rest = torch.where(small, 1 / 6 - squared / 120 + squared**2 / 5040, (angle - angle.sin()) / angle**3)
    cross = _cross(axis_angle)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + versine[..., None, None] * cross + rest[..., None, None] * (cross @ cross)


def _cross(vector: Tensor) -> Tensor:
    """(..., 3, 3) matrices [v] of cross products: [v] u = v x u."""
    x, y, z = vector.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def quaternion_to_matrix(quaternion: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), w, x, y, z."""
    w, vector = quaternion[..., :1, None], quaternion[..., 1:]
    outer = vector[..., :, None] * vector[..., None, :]
    identity = torch.eye(3, dtype=quaternion.dtype, device=quaternion.device)
    # R = (w^2 - |v|^2) I + 2 v v^T + 2 w [v]x
    return (2.0 * w**2 - 1.0) * identity + 2.0 * (outer + w * _cross(vector))
