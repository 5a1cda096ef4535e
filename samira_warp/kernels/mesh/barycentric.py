"""The point of a triangle closest to a given point: the geometric half of Alg. 1."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 4096
"""Points that are worth a thread."""


def closest_barycentrics(points: Tensor, triangles: Tensor) -> Tensor:
    """Weights of the corners at the point of each triangle that is closest to its own point (Alg. 1).

    They are constants, without a gradient. The point projects into one of seven Voronoi regions: three
    corners, three edges, the interior. A triangle whose corners coincide counts as the segment or the point
    that it is; of a needle too thin for float32 the result is one of its points, not always the closest.

    Args:
        points: (N, 3) float32.
        triangles: (N, 3, 3) float32 corners a, b, c of each point's triangle, on the same device.

    Returns:
        (N, 3) float32 weights, none below 0, summing to 1.

    Raises:
        UserError: A tensor has another shape, dtype or device.
    """
    check_tensors(("points", points, ("N", 3)), ("triangles", triangles, ("N", 3, 3)))
    barycentrics = torch.empty_like(points, memory_format=torch.contiguous_format)
    launch_range(
        _closest, points.shape[0], points.contiguous(), triangles.contiguous(), barycentrics, grain=GRAIN
    )
    return barycentrics


@wp.func
def _share(part: wp.float32, rest: wp.float32) -> wp.float32:
    """Ratio part / (part + rest), and 0 where both vanish."""
    total = part + rest
    if total > 0.0:
        return part / total
    return 0.0


@wp.func
def _closest_weights(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Weights by Voronoi region; d1 to d6 are Alg. 1's, the components of ap, bp and cp along ab and ac.

    d1 - d3 is the square of ab: where a is b, that edge leaves its region to ac.
    """
    ab = b - a
    ac = c - a
    d1 = wp.dot(ab, p - a)
    d2 = wp.dot(ac, p - a)
    d3 = wp.dot(ab, p - b)
    d4 = wp.dot(ac, p - b)
    d5 = wp.dot(ab, p - c)
    d6 = wp.dot(ac, p - c)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)

    weight_a = d3 * d6 - d5 * d4
    weight_b = d5 * d2 - d1 * d6
    weight_c = d1 * d4 - d3 * d2
    if weight_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:
        along = _share(d1, -d3)
        return wp.vec3(1.0 - along, along, 0.0)
    if weight_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        along = _share(d2, -d6)
        return wp.vec3(1.0 - along, 0.0, along)
    if weight_a <= 0.0 and d4 >= d3 and d5 >= d6:
        along = _share(d4 - d3, d5 - d6)
        return wp.vec3(0.0, 1.0 - along, along)
    return wp.vec3(weight_a, weight_b, weight_c)


@wp.kernel(enable_backward=False)
def _closest(
    first: wp.int32,
    points: wp.array[wp.vec3],
    triangles: wp.array2d[wp.vec3],
    barycentrics: wp.array[wp.vec3],
) -> None:
    """One point: Alg. 1's loop body, clamped and normalised."""
    index = first + wp.tid()
    weights = _closest_weights(points[index], triangles[index, 0], triangles[index, 1], triangles[index, 2])
    weights = wp.max(weights, wp.vec3(0.0))
    total = weights[0] + weights[1] + weights[2]
    if total > 0.0:
        barycentrics[index] = weights / total
    else:
        barycentrics[index] = wp.vec3(1.0, 1.0, 1.0) / 3.0
