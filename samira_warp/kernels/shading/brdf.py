"""Reading the BRDF table of Eq. pbr_color inside a kernel, with its slopes.

The table (N, N, 2) of (B_x, B_y) has its nodes on the borders: rows by roughness, columns by the root of
n . v, both from 0 to 1. It is read bilinearly.
"""

from __future__ import annotations

import warp as wp

GRAZING = wp.constant(1e-6)
"""Least n . v at which the table is read: its axis is the root of n . v, whose slope has no bound at 0."""


@wp.struct
class BrdfPlace:
    """A point in the BRDF table: the node before it, the place between nodes, and how that moves.

    ``y_slope`` is the derivative of the row by the roughness, ``x_slope`` that of the column by n . v.
    """

    row: wp.int32
    column: wp.int32
    y: wp.float32
    x: wp.float32
    y_slope: wp.float32
    x_slope: wp.float32


@wp.func
def find_brdf(roughness: wp.float32, cosine: wp.float32, nodes: wp.int32) -> BrdfPlace:
    """Where the BRDF table is read."""
    last = wp.float32(nodes - 1)
    root = wp.sqrt(wp.clamp(cosine, GRAZING, 1.0))
    place = BrdfPlace()
    y = wp.clamp(roughness, 0.0, 1.0) * last
    x = root * last
    place.row = wp.clamp(wp.int32(y), 0, nodes - 2)
    place.column = wp.clamp(wp.int32(x), 0, nodes - 2)
    place.y = y - wp.float32(place.row)
    place.x = x - wp.float32(place.column)
    place.y_slope = wp.where(roughness >= 0.0 and roughness <= 1.0, last, 0.0)
    place.x_slope = wp.where(cosine >= GRAZING and cosine <= 1.0, 0.5 * last / root, 0.0)
    return place


@wp.func
def brdf_row(brdf: wp.array2d[wp.vec2], row: wp.int32, place: BrdfPlace) -> wp.vec2:
    """(B_x, B_y) between the nodes of one row."""
    return (1.0 - place.x) * brdf[row, place.column] + place.x * brdf[row, place.column + 1]


@wp.func
def read_brdf(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """(B_x, B_y), bilinear."""
    return (1.0 - place.y) * brdf_row(brdf, place.row, place) + place.y * brdf_row(brdf, place.row + 1, place)


@wp.func
def brdf_slope_roughness(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """Slope of (B_x, B_y) along the roughness."""
    return place.y_slope * (brdf_row(brdf, place.row + 1, place) - brdf_row(brdf, place.row, place))


@wp.func
def brdf_slope_cosine(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """Slope of (B_x, B_y) along n . v."""
    upper = brdf[place.row, place.column + 1] - brdf[place.row, place.column]
    lower = brdf[place.row + 1, place.column + 1] - brdf[place.row + 1, place.column]
    return place.x_slope * ((1.0 - place.y) * upper + place.y * lower)
