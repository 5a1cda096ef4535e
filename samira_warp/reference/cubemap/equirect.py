"""The pictures of `samira_warp.kernels.cubemap.equirect` in plain torch, for any floating dtype."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.light.equirect import direction_to_equirect, wrap_equirect


def picture_equirect(equirect: Tensor, directions: Tensor) -> Tensor:
    """As `samira_warp.kernels.cubemap.equirect.picture_equirect`."""
    height, width = equirect.shape[:2]
    u, v = direction_to_equirect(directions)
    # among the padded pixels, the four nearest a point begin one and a half before it, and two pixels of
    # border come first
    x, y = u * width + 0.5, v * height + 0.5
    column, row = x.floor(), y.floor()
    across, down = _spline_weights(x - column), _spline_weights(y - row)
    padded = wrap_equirect(equirect, border=2)
    seen = equirect.new_zeros(*directions.shape[:-1], equirect.shape[2])
    for j in range(4):
        for i in range(4):
            seen += (down[..., j] * across[..., i])[..., None] * padded[row.long() + j, column.long() + i]
    return seen


def _spline_weights(place: Tensor) -> Tensor:
    """(..., 4) weights of the uniform cubic B-spline for its four nearest knots.

    ``place`` (...) is 0..1 between the middle two.
    """
    rest = 1.0 - place
    inner = (4.0 - 6.0 * place**2 + 3.0 * place**3, 4.0 - 6.0 * rest**2 + 3.0 * rest**3)
    return torch.stack([rest**3, *inner, place**3], dim=-1) / 6.0
