"""Outlines of a mesh in an image of it: where its edges pass between it and what is behind."""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.mesh.mesh_raster import NOTHING, key_of
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import NEAR_PLANE
from samira_warp.support.image_size import LARGEST_SIDE

OUTSIDE = 2.0 * LARGEST_SIDE
"""Pixels: a coordinate past all images, which still is an integer."""


class Outlines(NamedTuple):
    """The outlines between pixels.

    Attributes:
        outermost: (B * H * W, 2) int64 keys of the edges that cross from a pixel to the next one in its row,
            and in its column.
        crosses: (B, E) bool, of each edge: whether it crosses there at all, outermost or not.
    """

    outermost: Tensor
    crosses: Tensor


def find_outlines(points: Tensor, face: Tensor, barycentrics: Tensor, topology: MeshTopology) -> Outlines:
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
    return Outlines(outermost, crosses)


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
def turned(p: wp.vec3, steep: wp.bool) -> wp.vec3:
    """From (x, y, z) to (across, along, z), and back."""
    if steep:
        return p
    return wp.vec3(p[1], p[0], p[2])


@wp.func
def edge_between(frame: wp.int32, points: wp.array2d[wp.vec3], start: wp.int32, end: wp.int32) -> Outline:
    """An edge, on whichever side its surface is."""
    outline = Outline()
    a = points[frame, start]
    b = points[frame, end]
    outline.steep = wp.abs(b[1] - a[1]) >= wp.abs(b[0] - a[0])
    outline.a = turned(a, outline.steep)
    outline.b = turned(b, outline.steep)
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
    outline = edge_between(frame, points, ends[edge, 0], ends[edge, 1])
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
def first_line(outline: Outline) -> wp.int32:
    """The first line of pixel centres that the edge crosses: of two edges that meet on one, one does."""
    return wp.int32(wp.ceil(wp.clamp(wp.min(outline.a[1], outline.b[1]), -1.0, OUTSIDE) - 0.5))


@wp.func
def last_line(outline: Outline) -> wp.int32:
    """The line after the last."""
    return wp.int32(wp.ceil(wp.clamp(wp.max(outline.a[1], outline.b[1]), -1.0, OUTSIDE) - 0.5))


@wp.func
def cross_line(outline: Outline, line: wp.int32) -> Crossing:
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
def turned_size(outline: Outline, width: wp.int32, height: wp.int32) -> wp.vec2i:
    """How many pixels there are across and along."""
    if outline.steep:
        return wp.vec2i(width, height)
    return wp.vec2i(height, width)


@wp.func
def pixel_number(
    outline: Outline, frame: wp.int32, across: wp.int32, along: wp.int32, width: wp.int32, height: wp.int32
) -> wp.int32:
    """Number of a pixel."""
    if outline.steep:
        return (frame * height + along) * width + across
    return (frame * height + across) * width + along


@wp.func
def pair_direction(outline: Outline) -> wp.int32:
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
    size = turned_size(outline, width, height)
    for along in range(wp.max(first_line(outline), 0), wp.min(last_line(outline), size[1])):
        crossing = cross_line(outline, along)
        if crossing.first < 0 or crossing.first + 1 >= size[0]:
            continue
        # the pixel on the side of the surface, and the other one
        own = pixel_number(outline, frame, crossing.first + wp.max(outline.side, 0), along, width, height)
        other = pixel_number(outline, frame, crossing.first + wp.max(-outline.side, 0), along, width, height)
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
            wp.atomic_min(outermost, wp.min(own, other), pair_direction(outline), key_of(left_bare, edge))


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
