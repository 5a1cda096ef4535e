"""From sampled residuals to the final Gaussian state (Eqs. offset_process and final_motion)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar.wrinkles import SLOPE_LIMIT

POSITION_LIMIT = 0.02
"""Metres, s_mu: more than tracking is wrong by, less than a lip's width."""


class LimitedResidual(NamedTuple):
    """A residual within its limits.

    Attributes:
        position: (..., 3) metres, s_mu tanh(o_mu).
        rotation: (..., 3) axis-angle radians, pi tanh(o_r).
        slopes: (..., 2) of wrinkles; (..., 0) of a network that gives none.
    """

    position: Tensor
    rotation: Tensor
    slopes: Tensor


def limit_residual(residual: Tensor) -> LimitedResidual:
    """What the network gives, held to its limits.

    Args:
        residual: (..., 6) o_mu and o_r, or (..., 8) with the slopes of wrinkles.
    """
    # all at once: of a part of each row it takes a multiple of the time
    position, rotation, slopes = torch.tanh(residual).tensor_split((3, 6), dim=-1)
    return LimitedResidual(POSITION_LIMIT * position, torch.pi * rotation, SLOPE_LIMIT * slopes)


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
