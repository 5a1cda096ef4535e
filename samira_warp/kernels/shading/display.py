"""From linear radiance to display values inside a kernel: the sRGB curve, and its slope.

`samira_warp.light.color` says the same in torch.
"""

from __future__ import annotations

import warp as wp

LINEAR_END = wp.constant(0.0031308)
"""Up to this linear value the curve is a line (IEC 61966-2-1)."""

LINE_SLOPE = wp.constant(12.92)
CURVE_SCALE = wp.constant(1.055)
CURVE_OFFSET = wp.constant(0.055)
CURVE_POWER = wp.constant(1.0 / 2.4)


@wp.func
def encode(linear: wp.float32) -> wp.float32:
    """The sRGB curve, not clipped."""
    if linear <= LINEAR_END:
        return LINE_SLOPE * linear
    return CURVE_SCALE * wp.pow(linear, CURVE_POWER) - CURVE_OFFSET


@wp.func
def encode_slope(linear: wp.float32) -> wp.float32:
    """Derivative of `encode`."""
    if linear <= LINEAR_END:
        return LINE_SLOPE
    return CURVE_SCALE * CURVE_POWER * wp.pow(linear, CURVE_POWER - 1.0)


@wp.func
def show(color: wp.vec3, encoded: wp.bool) -> wp.vec3:
    """Display values of linear radiance: by the sRGB curve where ``encoded``, else as they are."""
    if not encoded:
        return color
    return wp.vec3(encode(color[0]), encode(color[1]), encode(color[2]))


@wp.func
def show_adjoint(color: wp.vec3, encoded: wp.bool, grad_shown: wp.vec3) -> wp.vec3:
    """Gradient with respect to the radiance, from that of `show`."""
    if not encoded:
        return grad_shown
    slope = wp.vec3(encode_slope(color[0]), encode_slope(color[1]), encode_slope(color[2]))
    return wp.cw_mul(slope, grad_shown)
