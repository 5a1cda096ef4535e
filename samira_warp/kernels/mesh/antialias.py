"""Outlines of a mesh in an image of it, blended by where they cross between pixels: their gradient.

A rasterised image is constant in the position of an outline until that meets the next pixel's centre. Laine
et al., Modular Primitives for High-Performance Differentiable Rendering (2020), blend two neighbouring pixels
by where an outline crosses the line between their centres. They look for it among the edges of the triangle
that the nearer pixel shows. A head's triangles are often smaller than a pixel, and the one with the outline's
edge seldom holds a centre. Here the mesh's own outlines are walked instead, edge by edge, and the outermost
one that crosses between two pixels blends them.
"""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.mesh.mesh_raster import NOTHING, MeshRaster, key_index
from samira_warp.kernels.mesh.outlines import (
    cross_line,
    edge_between,
    find_outlines,
    first_line,
    last_line,
    pair_direction,
    pixel_number,
    turned,
    turned_size,
)
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 4096
"""Pixels, or vertices, that are worth a thread."""


def antialias(image: Tensor, raster: MeshRaster, points: Tensor, topology: MeshTopology) -> Tensor:
    """Blend pixels across the mesh's outlines, differentiably in the image and the points' x and y.

    An edge is an outline where its two triangles lie on the same side of it on the screen, or where it has
    one. Of two neighbouring pixels whose centres it passes between, the one on its own side shows a triangle,
    and the other one what is behind the edge: nothing, or a triangle that is farther than the edge and than
    the first pixel's. Steep edges blend neighbours in a row, flat ones neighbours in a column, so that each
    sweeps its own area. The pixel that the outline reaches into takes as much of its neighbour's colour as
    the outline has passed the middle between the two.

    Args:
        image: (B, H, W, C) float32.
        raster: What the pixels show.
        points: (B, V, 3) float32, as they were rasterised.
        topology: The mesh, on the same device.

    Returns:
        (B, H, W, C) float32.

    Raises:
        UserError: A tensor has another shape, dtype or device than the others need.
    """
    check_tensors(
        ("raster.face", raster.face, ("B", "H", "W"), torch.int32),
        ("raster.barycentrics", raster.barycentrics, ("B", "H", "W", 3)),
        ("raster.boxes", raster.boxes, ("B", topology.faces.shape[0], 4), torch.int32),
        ("image", image, ("B", "H", "W", "C")),
        ("points", points, ("B", topology.vertex_count, 3)),
        device=topology.faces.device,
    )
    return _Antialias.apply(image, points, raster.face, raster.barycentrics.detach(), topology)


class _Antialias(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, image: Tensor, points: Tensor, face: Tensor, barycentrics: Tensor, topology: MeshTopology
    ) -> Tensor:
        image, points = image.contiguous(), points.contiguous()
        outlines = find_outlines(points, face.contiguous(), barycentrics.contiguous(), topology)
        blended, (height, width, channels) = torch.empty_like(image), image.shape[1:]
        crossed = (points, topology.edges.ends, width, height, outlines.outermost)
        colors = (image.view(-1, channels), blended.view(-1, channels))
        launch_range(_blend, face.numel(), *crossed, *colors, grain=GRAIN)
        ctx.save_for_backward(image, points, *outlines)
        ctx.topology = topology
        return blended

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_blended: Tensor) -> tuple[Tensor | None, Tensor | None, None, None, None]:
        image, points, outermost, crosses = ctx.saved_tensors
        ends, _, ends_of = ctx.topology.edges
        height, width, channels = image.shape[1:]
        crossed = (points, ends, width, height, outermost)
        grad_blended = grad_blended.reshape(-1, channels)
        grad_image = grad_points = None
        if ctx.needs_input_grad[0]:
            grad_image = torch.empty_like(image)
            grads = (grad_blended, grad_image.view(-1, channels))
            launch_range(_blend_adjoint, len(outermost), *crossed, *grads, grain=GRAIN)
        if ctx.needs_input_grad[1]:
            grad_points = torch.empty_like(points)
            seen = (crosses, *ends_of, image.view(-1, channels), grad_blended)
            vertices = points.shape[0] * points.shape[1]
            launch_range(_gather_vertex, vertices, *crossed, *seen, grad_points, grain=GRAIN)
        return grad_image, grad_points, None, None, None


@wp.func
def _shift(
    pixel: wp.int32,
    direction: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    outermost: wp.array2d[wp.int64],
) -> wp.float32:
    """How far the outline between a pixel and its next neighbour is from the middle; 0 without one.

    Greater than 0, the second pixel takes that share of the first one's colour; less, the first one of the
    second's.
    """
    if pixel < 0:
        return 0.0
    # no outline crosses from the last pixel of a row or a column: the next one is another's first
    key = outermost[pixel, direction]
    if key == NOTHING:
        return 0.0
    line = pixel // width
    frame = line // height
    along = wp.where(direction == 0, line - frame * height, pixel - line * width)
    edge = key_index(key)
    return cross_line(edge_between(frame, points, ends[edge, 0], ends[edge, 1]), along).shift


@wp.kernel(enable_backward=False)
def _blend(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    outermost: wp.array2d[wp.int64],
    image: wp.array2d[wp.float32],
    blended: wp.array2d[wp.float32],
) -> None:
    """One pixel: what it takes of its four neighbours."""
    pixel = first + wp.tid()
    left = wp.max(_shift(pixel - 1, 0, points, ends, width, height, outermost), 0.0)
    above = wp.max(_shift(pixel - width, 1, points, ends, width, height, outermost), 0.0)
    right = wp.max(-_shift(pixel, 0, points, ends, width, height, outermost), 0.0)
    below = wp.max(-_shift(pixel, 1, points, ends, width, height, outermost), 0.0)
    for channel in range(image.shape[1]):
        own = image[pixel, channel]
        total = own
        if left > 0.0:
            total += left * (image[pixel - 1, channel] - own)
        if above > 0.0:
            total += above * (image[pixel - width, channel] - own)
        if right > 0.0:
            total += right * (image[pixel + 1, channel] - own)
        if below > 0.0:
            total += below * (image[pixel + width, channel] - own)
        blended[pixel, channel] = total


@wp.kernel(enable_backward=False)
def _blend_adjoint(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    outermost: wp.array2d[wp.int64],
    grad_blended: wp.array2d[wp.float32],
    grad_image: wp.array2d[wp.float32],
) -> None:
    """One pixel: what of it was replaced by its neighbours' colours, and what it gave to theirs."""
    pixel = first + wp.tid()
    left = _shift(pixel - 1, 0, points, ends, width, height, outermost)
    above = _shift(pixel - width, 1, points, ends, width, height, outermost)
    right = _shift(pixel, 0, points, ends, width, height, outermost)
    below = _shift(pixel, 1, points, ends, width, height, outermost)
    taken = wp.max(left, 0.0) + wp.max(above, 0.0) + wp.max(-right, 0.0) + wp.max(-below, 0.0)
    for channel in range(grad_image.shape[1]):
        total = (1.0 - taken) * grad_blended[pixel, channel]
        if left < 0.0:
            total -= left * grad_blended[pixel - 1, channel]
        if above < 0.0:
            total -= above * grad_blended[pixel - width, channel]
        if right > 0.0:
            total += right * grad_blended[pixel + 1, channel]
        if below > 0.0:
            total += below * grad_blended[pixel + width, channel]
        grad_image[pixel, channel] = total


@wp.func
def _end_gradient(
    frame: wp.int32,
    edge: wp.int32,
    end: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    outermost: wp.array2d[wp.int64],
    image: wp.array2d[wp.float32],
    grad_blended: wp.array2d[wp.float32],
) -> wp.vec3:
    """What the pixels that an edge blends say of one of its ends."""
    outline = edge_between(frame, points, ends[edge, 0], ends[edge, 1])
    slope = (outline.b[0] - outline.a[0]) / (outline.b[1] - outline.a[1])
    grad = wp.vec3(0.0)
    size = turned_size(outline, width, height)
    for along in range(wp.max(first_line(outline), 0), wp.min(last_line(outline), size[1])):
        crossing = cross_line(outline, along)
        if crossing.first < 0 or crossing.first + 1 >= size[0]:
            continue
        pixel = pixel_number(outline, frame, crossing.first, along, width, height)
        after = pixel_number(outline, frame, crossing.first + 1, along, width, height)
        key = outermost[pixel, pair_direction(outline)]
        if key == NOTHING or key_index(key) != edge:
            continue
        # the pixel that takes gets more of the first one's colour, and less of the second's, as the crossing
        # moves towards the second
        taking = wp.where(crossing.shift > 0.0, after, pixel)
        grad_across = wp.float32(0.0)
        for channel in range(image.shape[1]):
            grad_across += grad_blended[taking, channel] * (image[pixel, channel] - image[after, channel])
        # the crossing follows the ends by their shares, and not at all along the edge's own line
        share = wp.where(end == 0, 1.0 - crossing.part, crossing.part)
        grad += share * grad_across * wp.vec3(1.0, -slope, 0.0)
    return turned(grad, outline.steep)


@wp.kernel(enable_backward=False)
def _gather_vertex(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    outermost: wp.array2d[wp.int64],
    crosses: wp.array2d[wp.bool],
    offsets: wp.array[wp.int32],
    members: wp.array[wp.int32],
    image: wp.array2d[wp.float32],
    grad_blended: wp.array2d[wp.float32],
    grad_points: wp.array2d[wp.vec3],
) -> None:
    """One vertex of one frame: the sum over the outlines that end in it."""
    index = first + wp.tid()
    frame = index // points.shape[1]
    vertex = index - frame * points.shape[1]
    total = wp.vec3(0.0)
    for entry in range(offsets[vertex], offsets[vertex + 1]):
        edge = members[entry] // 2
        if crosses[frame, edge]:
            end = members[entry] - 2 * edge
            total += _end_gradient(
                frame, edge, end, points, ends, width, height, outermost, image, grad_blended
            )
    grad_points[frame, vertex] = total
