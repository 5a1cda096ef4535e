"""Outlines of a mesh in an image of it, blended by where they cross between pixels: their gradient.

A rasterised image is constant in the position of an outline until that meets the next pixel's centre. Laine
et al., Modular Primitives for High-Performance Differentiable Rendering (2020), blend two neighbouring pixels
by where an outline crosses the line between their centres. They look for it among the edges of the triangle
that the nearer pixel shows. A head's triangles are often smaller than a pixel, and the one with the outline's
edge seldom holds a centre. Here the mesh's own outlines are walked instead, edge by edge, and the outermost
one that crosses between two pixels blends them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.mesh.mesh_raster import NOTHING, MeshRaster, key_index, key_of
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import NEAR_PLANE
from samira_warp.support.image_size import LARGEST_SIDE
from samira_warp.support.validation import check_tensors

GRAIN = 4096
"""Pixels, or edges, that are worth a thread."""

OUTSIDE = 2.0 * LARGEST_SIDE
"""Pixels: a coordinate past all images, which still is an integer."""


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
        outlines = _find_outlines(points, face.contiguous(), barycentrics.contiguous(), topology)
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


class _Outlines(NamedTuple):
    """The outlines between pixels.

    Attributes:
        outermost: (B * H * W, 2) int64 keys of the edges that cross from a pixel to the next one in its row,
            and in its column.
        crosses: (B, E) bool, of each edge: whether it crosses there at all, outermost or not.
    """

    outermost: Tensor
    crosses: Tensor


def _find_outlines(points: Tensor, face: Tensor, barycentrics: Tensor, topology: MeshTopology) -> _Outlines:
    """Walk all edges: on a GPU at once, with atomic minima; on a CPU a thread has the edges of a frame."""
    frames, height, width = face.shape
    ends, opposites, _ = topology.edges
    outermost = torch.full((face.numel(), 2), NOTHING.value, dtype=torch.int64, device=points.device)
    crosses = torch.zeros(frames, ends.shape[0], dtype=torch.bool, device=points.device)
    seen = (width, height, face.view(-1), barycentrics.view(-1, 3))
    walked = (points, topology.faces, ends, opposites, *seen, outermost, crosses)
    if points.device.type == "cuda":
        launch_range(_walk_edge, frames * ends.shape[0], *walked)
    else:
        launch_range(_walk_edges, frames, *walked)
    return _Outlines(outermost, crosses)


@wp.struct
class Outline:
    """An outline's edge, in coordinates (across, along): its pairs of pixels are neighbours in the first.

    Attributes:
        steep: Whether across is x and along y, and not the other way round.
        side: Where the surface is: 1 at the greater coordinate across, -1 at the lesser; 0 of an edge that is
            no outline.
        a: The first end: across, along, and depth.
        b: The other end.
    """

    steep: wp.bool
    side: wp.int32
    a: wp.vec3
    b: wp.vec3


@wp.struct
class Crossing:
    """Where an outline passes between two pixels' centres.

    Attributes:
        part: How far along the edge, 0 to 1.
        first: The coordinate across of the lesser pixel.
        shift: How far from the middle between the two, -0.5 to 0.5.
        depth: The edge's depth there.
    """

    part: wp.float32
    first: wp.int32
    shift: wp.float32
    depth: wp.float32


@wp.func
def _side_of(
    frame: wp.int32, vertex: wp.int32, points: wp.array2d[wp.vec3], a: wp.vec3, b: wp.vec3
) -> wp.int32:
    """On which side of the line from a to b a vertex is on the screen: 1 or -1; 0 on it, or of none."""
    if vertex < 0:
        return 0
    p = points[frame, vertex]
    area = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    # the triangle is not drawn
    if not (p[2] > NEAR_PLANE and wp.isfinite(area)):
        return 0
    if area > 0.0:
        return 1
    if area < 0.0:
        return -1
    return 0


@wp.func
def _turned(p: wp.vec3, steep: wp.bool) -> wp.vec3:
    """From (x, y, z) to (across, along, z), and back."""
    if steep:
        return p
    return wp.vec3(p[1], p[0], p[2])


@wp.func
def _edge_between(frame: wp.int32, points: wp.array2d[wp.vec3], start: wp.int32, end: wp.int32) -> Outline:
    """An edge, on whichever side its surface is."""
    outline = Outline()
    a = points[frame, start]
    b = points[frame, end]
    outline.steep = wp.abs(b[1] - a[1]) >= wp.abs(b[0] - a[0])
    outline.a = _turned(a, outline.steep)
    outline.b = _turned(b, outline.steep)
    return outline


@wp.func
def _outline(
    frame: wp.int32,
    edge: wp.int32,
    points: wp.array2d[wp.vec3],
    ends: wp.array2d[wp.int32],
    opposites: wp.array2d[wp.int32],
) -> Outline:
    """An edge, and the side of its surface where it is an outline."""
    outline = _edge_between(frame, points, ends[edge, 0], ends[edge, 1])
    a = points[frame, ends[edge, 0]]
    b = points[frame, ends[edge, 1]]
    side = _side_of(frame, opposites[edge, 0], points, a, b) + _side_of(
        frame, opposites[edge, 1], points, a, b
    )
    # a positive area is to the left of an edge that goes down the image, below one that goes to its right
    along = outline.b[1] - outline.a[1]
    if outline.steep:
        along = -along
    if wp.min(a[2], b[2]) > NEAR_PLANE and wp.isfinite(wp.length_sq(a) + wp.length_sq(b)):
        outline.side = wp.int32(wp.sign(along)) * wp.sign(side)
        if side == 0 or along == 0.0:
            outline.side = 0
    return outline


@wp.func
def _first_line(outline: Outline) -> wp.int32:
    """The first line of pixel centres that the edge crosses: of two edges that meet on one, one does."""
    return wp.int32(wp.ceil(wp.clamp(wp.min(outline.a[1], outline.b[1]), -1.0, OUTSIDE) - 0.5))


@wp.func
def _last_line(outline: Outline) -> wp.int32:
    """The line after the last."""
    return wp.int32(wp.ceil(wp.clamp(wp.max(outline.a[1], outline.b[1]), -1.0, OUTSIDE) - 0.5))


@wp.func
def _cross(outline: Outline, line: wp.int32) -> Crossing:
    """Where an edge crosses a line of pixel centres."""
    crossing = Crossing()
    crossing.part = (wp.float32(line) + 0.5 - outline.a[1]) / (outline.b[1] - outline.a[1])
    across = outline.a[0] + crossing.part * (outline.b[0] - outline.a[0])
    lesser = wp.floor(across - 0.5)
    crossing.first = wp.int32(wp.clamp(lesser, -1.0, OUTSIDE))
    crossing.shift = across - lesser - 1.0
    # the reciprocal of the depth is linear on the screen
    crossing.depth = 1.0 / ((1.0 - crossing.part) / outline.a[2] + crossing.part / outline.b[2])
    return crossing


@wp.func
def _turned_size(outline: Outline, width: wp.int32, height: wp.int32) -> wp.vec2i:
    """How many pixels there are across and along."""
    if outline.steep:
        return wp.vec2i(width, height)
    return wp.vec2i(height, width)


@wp.func
def _pixel(
    outline: Outline, frame: wp.int32, across: wp.int32, along: wp.int32, width: wp.int32, height: wp.int32
) -> wp.int32:
    """Number of a pixel."""
    if outline.steep:
        return (frame * height + along) * width + across
    return (frame * height + across) * width + along


@wp.func
def _direction(outline: Outline) -> wp.int32:
    """0 where its pairs are neighbours in a row, 1 where they are in a column."""
    return wp.where(outline.steep, 0, 1)


@wp.func
def _depth_at(
    frame: wp.int32,
    pixel: wp.int32,
    shown: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    barycentrics: wp.array[wp.vec3],
) -> wp.float32:
    """Depth of the triangle that a pixel shows; without bounds where it shows none."""
    if shown < 0:
        return wp.inf
    depths = wp.vec3(
        points[frame, faces[shown, 0]][2],
        points[frame, faces[shown, 1]][2],
        points[frame, faces[shown, 2]][2],
    )
    return wp.dot(barycentrics[pixel], depths)


@wp.func
def _walk(
    frame: wp.int32,
    edge: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    ends: wp.array2d[wp.int32],
    opposites: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    outermost: wp.array2d[wp.int64],
    crosses: wp.array2d[wp.bool],
) -> None:
    """Put an edge's key between the pixels that it passes, where it is an outline that is seen."""
    outline = _outline(frame, edge, points, ends, opposites)
    if outline.side == 0:
        return
    size = _turned_size(outline, width, height)
    for along in range(wp.max(_first_line(outline), 0), wp.min(_last_line(outline), size[1])):
        crossing = _cross(outline, along)
        if crossing.first < 0 or crossing.first + 1 >= size[0]:
            continue
        # the pixel on the side of the surface, and the other one
        own = _pixel(outline, frame, crossing.first + wp.max(outline.side, 0), along, width, height)
        other = _pixel(outline, frame, crossing.first + wp.max(-outline.side, 0), along, width, height)
        shown = face[own]
        behind = face[other]
        if shown < 0 or shown == behind:
            continue
        depth = _depth_at(frame, own, shown, points, faces, barycentrics)
        depth_behind = _depth_at(frame, other, behind, points, faces, barycentrics)
        if depth_behind > wp.max(depth, crossing.depth):
            crosses[frame, edge] = True
            # all that pass between these two have the same side: the farthest out is what they cover together
            left_bare = wp.max(0.5 + wp.float32(outline.side) * crossing.shift, 0.0)
            wp.atomic_min(outermost, wp.min(own, other), _direction(outline), key_of(left_bare, edge))


@wp.kernel(enable_backward=False)
def _walk_edge(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    ends: wp.array2d[wp.int32],
    opposites: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    outermost: wp.array2d[wp.int64],
    crosses: wp.array2d[wp.bool],
) -> None:
    """One edge of one frame; the least key is the same in whatever order they come."""
    index = first + wp.tid()
    frame = index // ends.shape[0]
    edge = index - frame * ends.shape[0]
    _walk(frame, edge, points, faces, ends, opposites, width, height, face, barycentrics, outermost, crosses)


@wp.kernel(enable_backward=False)
def _walk_edges(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    ends: wp.array2d[wp.int32],
    opposites: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    outermost: wp.array2d[wp.int64],
    crosses: wp.array2d[wp.bool],
) -> None:
    """All edges of one frame: no other thread writes there."""
    frame = first + wp.tid()
    for edge in range(ends.shape[0]):
        _walk(
            frame, edge, points, faces, ends, opposites, width, height, face, barycentrics, outermost, crosses
        )


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
    return _cross(_edge_between(frame, points, ends[edge, 0], ends[edge, 1]), along).shift


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
    outline = _edge_between(frame, points, ends[edge, 0], ends[edge, 1])
    slope = (outline.b[0] - outline.a[0]) / (outline.b[1] - outline.a[1])
    grad = wp.vec3(0.0)
    size = _turned_size(outline, width, height)
    for along in range(wp.max(_first_line(outline), 0), wp.min(_last_line(outline), size[1])):
        crossing = _cross(outline, along)
        if crossing.first < 0 or crossing.first + 1 >= size[0]:
            continue
        pixel = _pixel(outline, frame, crossing.first, along, width, height)
        after = _pixel(outline, frame, crossing.first + 1, along, width, height)
        key = outermost[pixel, _direction(outline)]
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
    return _turned(grad, outline.steep)


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
