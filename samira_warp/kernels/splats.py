"""Splat records: all that a pixel needs of a projected Gaussian, side by side in memory.

Exponents are in base 2, so that the density of a Gaussian at the offset (dx, dy) of a pixel centre from its mean is

    opacity * exp(-sigma) = 2^(level - (xx dx^2 + xy dx dy + yy dy^2))

with level = log2(opacity), and the ellipse in which that reaches ALPHA_MIN is where the quadratic form is at most the record's cut.
"""

from __future__ import annotations

import math

import warp as wp
from torch import Tensor

from samira_warp.constants import ALPHA_MIN
from samira_warp.kernels.runtime import launch_range

RECORD = 8
"""Floats of a record before its features: mean x, y; quadratic form xx, xy, yy; level; cut; 1 / opacity."""

GRAIN = 2048
"""Gaussians that are worth a thread."""

LOG2_E = wp.constant(1.0 / math.log(2.0))


def pack_splats(means2d: Tensor, conics: Tensor, opacities: Tensor, features: Tensor, *, multiple: int) -> Tensor:
    """(N, RECORD + P) records of N Gaussians, features padded with zeros to P channels, the next multiple of ``multiple``."""
    count, channels = features.shape
    splats = means2d.new_empty(count, RECORD + -(-channels // multiple) * multiple)
    launch_range(_pack, count, means2d, conics, opacities, features, splats, grain=GRAIN)
    return splats


@wp.kernel(enable_backward=False)
def _pack(
    first: wp.int32,
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    features: wp.array2d[wp.float32],
    splats: wp.array2d[wp.float32],
):
    """Write the record of each Gaussian: RECORD floats, then its features padded with zeros to the row's end."""
    i = first + wp.tid()
    # Gaussians that no tile lists may hold anything; level and cut then stay unread
    level = wp.log2(opacities[i])
    splats[i, 0] = means2d[i][0]
    splats[i, 1] = means2d[i][1]
    splats[i, 2] = 0.5 * LOG2_E * conics[i][0]
    splats[i, 3] = LOG2_E * conics[i][1]
    splats[i, 4] = 0.5 * LOG2_E * conics[i][2]
    splats[i, 5] = level
    splats[i, 6] = (level - wp.static(math.log2(ALPHA_MIN))) * 1.0001 + 0.0015
    splats[i, 7] = 1.0 / opacities[i]
    channels = features.shape[1]
    for c in range(channels):
        splats[i, RECORD + c] = features[i, c]
    for c in range(RECORD + channels, splats.shape[1]):
        splats[i, c] = 0.0
