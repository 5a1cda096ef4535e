"""Splat records: all that a pixel needs of a projected Gaussian, side by side in memory.

Exponents are in base 2, so that the density of a Gaussian at the offset (dx, dy) of a pixel centre from its
mean is

    opacity * exp(-sigma) = 2^(level - (root dx + shear dy)^2 - rest dy^2)

with level = log2(opacity), and the ellipse in which that reaches ALPHA_MIN is where the two squares sum to at
most the record's cut. The squares (a Cholesky factor of the conic) keep float32 accurate far along a thin
ellipse, where the three terms of the expanded form are thousands and cancel to a few units.
"""

from __future__ import annotations

import math

import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.tiles import TileBins
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import ALPHA_MIN

RECORD = 8
"""Floats of a record before its features: mean x, y; root, shear, rest; level; cut; 1 / opacity."""

GRAIN = 2048
"""Gaussians that are worth a thread."""

HALF_LOG2_E = wp.constant(wp.float64(0.5 / math.log(2.0)))
"""Turns the conic's sigma = (1/2) d' K d into a power of two."""


def pack_splats(
    means2d: Tensor, conics: Tensor, opacities: Tensor, features: Tensor, bins: TileBins, *, multiple: int
) -> Tensor:
    """(N, RECORD + P) records of N Gaussians, their features padded with zeros to P channels.

    P is the next multiple of ``multiple``. Records are numbered by ``bins``; those past the last in use are
    not written, nor is their memory touched.
    """
    count, channels = features.shape
    splats = means2d.new_empty(count, RECORD + -(-channels // multiple) * multiple)
    launch_range(_pack, count, bins.record_offsets, means2d, conics, opacities, features, splats, grain=GRAIN)
    return splats


@wp.func_native(f"""
    const int channels = features.shape[1], stride = splats.shape[1];
    float* __restrict__ to = splats.data + (size_t)record * stride + {RECORD};
    const float* __restrict__ from = features.data + (size_t)i * channels;
    for (int c = 0; c < channels; ++c) to[c] = from[c];
    for (int c = channels; c < stride - {RECORD}; ++c) to[c] = 0.0f;
""")
def _copy_features(
    splats: wp.array2d[wp.float32], record: wp.int32, features: wp.array2d[wp.float32], i: wp.int32
) -> None: ...


@wp.kernel(enable_backward=False)
def _pack(
    first: wp.int32,
    record_offsets: wp.array[wp.int32],
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    features: wp.array2d[wp.float32],
    splats: wp.array2d[wp.float32],
) -> None:
    """Write the record of each Gaussian: RECORD floats, then its features, then zeros to the row's end."""
    i = first + wp.tid()
    record = record_offsets[i]
    # it touches no tile
    if record == record_offsets[i + 1]:
        return

    level = wp.log2(opacities[i])
    # the conic's Cholesky factor; rest is a difference of products: in float64 it loses nothing
    root = wp.sqrt(HALF_LOG2_E * wp.float64(conics[i][0]))
    shear = HALF_LOG2_E * wp.float64(conics[i][1]) / root
    splats[record, 0] = means2d[i][0]
    splats[record, 1] = means2d[i][1]
    splats[record, 2] = wp.float32(root)
    splats[record, 3] = wp.float32(shear)
    splats[record, 4] = wp.float32(HALF_LOG2_E * wp.float64(conics[i][2]) - shear * shear)
    splats[record, 5] = level
    # the cut, a little further out than ALPHA_MIN lies: an ellipse must not lose a pixel to rounding
    splats[record, 6] = (level - wp.static(math.log2(ALPHA_MIN))) * 1.0001 + 0.0015
    splats[record, 7] = 1.0 / opacities[i]
    _copy_features(splats, record, features, i)
