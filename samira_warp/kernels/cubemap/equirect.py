"""Pictures of a panorama: the cubic B-spline of its pixels, by direction.

What a column and a row mean: `samira_warp.light.equirect`.
"""

from __future__ import annotations

import math

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor

GRAIN = 2048
"""Directions that are worth a thread."""

_PI = wp.constant(math.pi)


def picture_equirect(equirect: Tensor, directions: Tensor) -> Tensor:
    """Look a panorama up for a picture of it: as soft as a lens, and no pixel shows however enlarged.

    Args:
        equirect: (H, W, 3) float32; a constant.
        directions: (..., 3) float32, unit; constants.

    Returns:
        (..., 3) float32, within the range of the pixels.

    Raises:
        UserError: A wrong shape, dtype or device, or no pixels.
    """
    check_tensor("equirect", equirect, shape=("H", "W", 3))
    if equirect.numel() == 0:
        raise UserError("equirect", expected="at least one pixel", found=tuple(equirect.shape))
    check_tensor("directions", directions, shape=(*directions.shape[:-1], 3), device=equirect.device)
    seen = torch.empty(directions.shape, device=equirect.device)
    inputs = (equirect.contiguous(), directions.reshape(-1, 3).contiguous())
    launch_range(_picture, seen.numel() // 3, *inputs, seen.view(-1, 3), grain=GRAIN)
    return seen


@wp.func
def _spline_weights(place: wp.float32) -> wp.vec4:
    """Weights of the uniform cubic B-spline for its four nearest knots, ``place`` in 0..1 between two."""
    rest = 1.0 - place
    before = 4.0 + place * place * (3.0 * place - 6.0)
    after = 4.0 + rest * rest * (3.0 * rest - 6.0)
    return wp.vec4(rest * rest * rest, before, after, place * place * place) / 6.0


@wp.func
def _row_of_four(pixels: wp.array2d[wp.vec3], row: wp.int32, column: wp.int32, weights: wp.vec4) -> wp.vec3:
    """Four neighbours of a row, weighted: across the seam, and beyond a pole on the other side of it."""
    height = pixels.shape[0]
    width = pixels.shape[1]
    inside = row
    place = column
    if row < 0 or row >= height:
        inside = wp.clamp(wp.where(row < 0, -1 - row, 2 * height - 1 - row), 0, height - 1)
        place += width // 2
    # two columns before the first, at the least, and half a turn past the last at the most
    place = (place + 2 * width) % width
    result = wp.vec3()
    for i in range(4):
        result += weights[i] * pixels[inside, place]
        place = wp.where(place + 1 == width, 0, place + 1)
    return result


@wp.kernel(enable_backward=False)
def _picture(
    first: wp.int32,
    pixels: wp.array2d[wp.vec3],
    directions: wp.array[wp.vec3],
    seen: wp.array[wp.vec3],
) -> None:
    m = first + wp.tid()
    direction = directions[m]
    u = 0.5 + wp.atan2(direction[0], -direction[2]) / (2.0 * _PI)
    v = wp.acos(wp.clamp(direction[1], -1.0, 1.0)) / _PI
    # the knots are the pixels' centres, and the four nearest begin one before
    x = (u - wp.floor(u)) * wp.float32(pixels.shape[1]) - 0.5
    y = v * wp.float32(pixels.shape[0]) - 0.5
    across = _spline_weights(x - wp.floor(x))
    down = _spline_weights(y - wp.floor(y))
    column = wp.int32(wp.floor(x)) - 1
    row = wp.int32(wp.floor(y)) - 1
    result = wp.vec3()
    for j in range(4):
        result += down[j] * _row_of_four(pixels, row + j, column, across)
    seen[m] = result
