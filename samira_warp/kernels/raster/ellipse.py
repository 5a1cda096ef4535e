"""Where a projected Gaussian can be seen: the ellipse inside which its alpha is at least ALPHA_MIN."""

from __future__ import annotations

import warp as wp

from samira_warp.support.constants import ALPHA_MIN

ROUNDING = wp.constant(1.0 - 2.0**-21)
"""Scales xx * yy in the determinant of a conic: float32 can then only make an ellipse larger, never lose a
pixel of it."""


@wp.func
def visible_sigma(opacity: wp.float32) -> wp.float32:
    """The sigma at which opacity * exp(-sigma) falls to ALPHA_MIN, and a margin for rounding.

    It is -1 where alpha never gets there.
    """
    if not (opacity >= wp.static(ALPHA_MIN) and wp.isfinite(opacity)):
        return -1.0
    return wp.log(opacity * wp.static(1.0 / ALPHA_MIN)) * 1.0001 + 0.001


@wp.func
def half_extent(conic: wp.vec3, sigma: wp.float32) -> wp.vec2:
    """Half the width and height, in pixels, of the box round the ellipse (1/2) d' K d <= sigma."""
    product = conic[0] * conic[2]
    determinant = wp.max(product * ROUNDING - conic[1] * conic[1], 1.0e-12 * product)
    return wp.vec2(
        wp.sqrt(2.0 * sigma * conic[2] / determinant), wp.sqrt(2.0 * sigma * conic[0] / determinant)
    )


@wp.func
def quadratic(conic: wp.vec3, x: wp.float32, y: wp.float32) -> wp.float32:
    """Sigma = (1/2) d' K d at the offset d = (x, y) from the mean."""
    return 0.5 * (conic[0] * x * x + conic[2] * y * y) + conic[1] * x * y


@wp.func
def touches(mean: wp.vec2, conic: wp.vec3, sigma: wp.float32, low: wp.vec2, high: wp.vec2) -> wp.bool:
    """Whether the ellipse meets the rectangle [low, high].

    The least sigma over the rectangle lies at the mean if it is inside, else on an edge that faces the mean,
    where it is the minimum of a parabola, clamped to the edge. Where the mean lies between two sides, the
    point taken for their edge is another one inside the rectangle, which does no harm, so nothing branches.
    """
    nearest = wp.vec2(wp.clamp(mean[0], low[0], high[0]), wp.clamp(mean[1], low[1], high[1])) - mean
    x = wp.clamp(-conic[1] / conic[0] * nearest[1], low[0] - mean[0], high[0] - mean[0])
    y = wp.clamp(-conic[1] / conic[2] * nearest[0], low[1] - mean[1], high[1] - mean[1])
    return wp.min(quadratic(conic, nearest[0], y), quadratic(conic, x, nearest[1])) <= sigma
