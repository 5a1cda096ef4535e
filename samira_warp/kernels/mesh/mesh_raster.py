"""Which triangle of a mesh each pixel shows, and where in the triangle: differentiable, for many frames."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.gathering.sums import sum_groups
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import NEAR_PLANE
from samira_warp.support.image_size import check_side
from samira_warp.support.validation import check_tensors

GRAIN = 4096
"""Pixels, or triangles, that are worth a thread."""

BANDS_PER_THREAD = 4
"""A CPU draws at least this many pieces per thread: frames, or bands of rows where the frames are fewer."""

NOTHING = wp.constant(wp.int64(2**63 - 1))
"""The key of a pixel, or of a pair of pixels, that nothing has reached: greater than all others."""


class MeshRaster(NamedTuple):
    """The nearest triangle of every pixel.

    Attributes:
        face: (B, H, W) int32 face id, -1 where no triangle covers the pixel's centre.
        barycentrics: (B, H, W, 3) float32 weights of the triangle's corners, in space and not on the screen;
            0 where there is none.
        boxes: (B, F, 4) int32 left, top, right, bottom (the last two exclusive): the pixels among which a
            triangle is seen, none where it is not.
    """

    face: Tensor
    barycentrics: Tensor
    boxes: Tensor


def rasterize_mesh(points: Tensor, topology: MeshTopology, *, width: int, height: int) -> MeshRaster:
    """Rasterise a projected mesh at pixel centres (column + 0.5, row + 0.5), frame by frame.

    The nearest triangle wins, of equally near ones the lowest id. Both sides are seen: heads are open at the
    neck, and some at the mouth and the eyes. Triangles that share an edge leave no gap along it: both
    evaluate it from the same end. One that has a corner at the near plane or behind it, or that is not
    finite, is not drawn.

    The barycentrics are differentiable in ``points``, for the triangles as they are seen. What a moving
    outline covers and uncovers is not in them: see `antialias`.

    Args:
        points: (B, V, 3) float32: x and y in pixels, and the depth in front of the camera in metres.
        topology: The mesh, on the same device.
        width: W, pixels.
        height: H, pixels.

    Raises:
        UserError: ``points`` has another shape, dtype or device than the topology needs, or the size is none
            that can be drawn.
    """
    check_side("width", width)
    check_side("height", height)
    check_tensors(("points", points, ("B", topology.vertex_count, 3)), device=topology.faces.device)
    return MeshRaster(*_RasterizeMesh.apply(points, topology, width, height))


class _RasterizeMesh(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, points: Tensor, topology: MeshTopology, width: int, height: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        points, faces = points.contiguous(), topology.faces
        frames, face_count = points.shape[0], faces.shape[0]
        boxes = torch.empty(frames, face_count, 4, dtype=torch.int32, device=points.device)
        launch_range(_bound, frames * face_count, points, faces, width, height, boxes, grain=GRAIN)
        nearest = _draw_all(points, faces, boxes, width, height)
        face = torch.empty(frames, height, width, dtype=torch.int32, device=points.device)
        barycentrics = points.new_empty(frames, height, width, 3)
        is_seen = torch.zeros(frames, face_count, dtype=torch.bool, device=points.device)
        shown = (nearest, face.view(-1), barycentrics.view(-1, 3), is_seen)
        launch_range(_resolve, face.numel(), points, faces, width, height, *shown, grain=GRAIN)
        # adjoints look through the boxes: most triangles lie behind others
        launch_range(_empty_hidden, frames * face_count, is_seen, boxes, grain=GRAIN)
        ctx.save_for_backward(points, face, boxes)
        ctx.topology = topology
        ctx.mark_non_differentiable(face, boxes)
        return face, barycentrics, boxes

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, _face: None, grad_barycentrics: Tensor, _boxes: None
    ) -> tuple[Tensor, None, None, None]:
        points, face, boxes = ctx.saved_tensors
        topology: MeshTopology = ctx.topology
        frames, face_count = boxes.shape[:2]
        grad_corners = points.new_empty(frames, 3 * face_count, 3)
        height, width = face.shape[1:]
        mesh = (points, topology.faces, boxes)
        seen = (width, height, face.view(-1), grad_barycentrics.contiguous().view(-1, 3))
        launch_range(_gather_corners, frames * face_count, *mesh, *seen, grad_corners, grain=GRAIN)
        return sum_groups(grad_corners, topology.corners), None, None, None


def _draw_all(points: Tensor, faces: Tensor, boxes: Tensor, width: int, height: int) -> Tensor:
    """(B * H * W,) int64 keys: the depth's bits, then the face's id.

    The least key is the same in whatever order they come. A GPU draws all triangles at once, with atomic
    minima; on a CPU a thread draws all triangles of one frame, or of one band of its rows.
    """
    frames, face_count = boxes.shape[:2]
    pixels = frames * height * width
    nearest = torch.full((pixels,), NOTHING.value, dtype=torch.int64, device=points.device)
    drawn = (points, faces, boxes, width, height, nearest)
    if points.device.type == "cuda":
        launch_range(_draw_triangle, frames * face_count, *drawn)
    elif frames:
        bands = min(-(-BANDS_PER_THREAD * torch.get_num_threads() // frames), height)
        launch_range(_draw_band, frames * bands, bands, *drawn)
    return nearest


@wp.func
def _edge(start: wp.int32, end: wp.int32, a: wp.vec3, b: wp.vec3, p: wp.vec2) -> wp.float32:
    """Twice the signed area of (a, b, p) on the screen: the same bits, but for the sign, from either end."""
    q = wp.where(start < end, a, b)
    return (b[0] - a[0]) * (p[1] - q[1]) - (b[1] - a[1]) * (p[0] - q[0])


@wp.func
def screen_weights(corners: wp.vec3i, a: wp.vec3, b: wp.vec3, c: wp.vec3, p: wp.vec2) -> wp.vec3:
    """Twice the signed areas across from the corners: all of one sign where the triangle holds p."""
    return wp.vec3(
        _edge(corners[1], corners[2], b, c, p),
        _edge(corners[2], corners[0], c, a, p),
        _edge(corners[0], corners[1], a, b, p),
    )


@wp.func
def face_corners(faces: wp.array2d[wp.int32], face: wp.int32) -> wp.vec3i:
    """The triangle's vertex ids."""
    return wp.vec3i(faces[face, 0], faces[face, 1], faces[face, 2])


@wp.func
def key_of(value: wp.float32, index: wp.int32) -> wp.int64:
    """A number that is less for a lesser value, none below 0, and of equal ones for a lower index."""
    # the bits of positive floats are in the floats' order
    return wp.int64(wp.cast(value, wp.int32)) << wp.int64(32) | wp.int64(index)


@wp.func
def key_index(key: wp.int64) -> wp.int32:
    """The index in a key."""
    return wp.int32(key & wp.int64(0x7FFFFFFF))


@wp.kernel(enable_backward=False)
def _bound(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    boxes: wp.array2d[wp.vec4i],
) -> None:
    """One triangle of one frame: the pixels whose centres lie in its bounding box."""
    index = first + wp.tid()
    frame = index // faces.shape[0]
    face = index - frame * faces.shape[0]
    a = points[frame, faces[face, 0]]
    b = points[frame, faces[face, 1]]
    c = points[frame, faces[face, 2]]
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    box = wp.vec4i(0)
    # a sum is finite only where all that is in it is
    if low[2] > NEAR_PLANE and wp.isfinite(wp.length_sq(a) + wp.length_sq(b) + wp.length_sq(c)):
        # clamped as floats: what lies far outside overflows an integer
        left = wp.int32(wp.clamp(wp.ceil(low[0] - 0.5), 0.0, wp.float32(width)))
        top = wp.int32(wp.clamp(wp.ceil(low[1] - 0.5), 0.0, wp.float32(height)))
        right = wp.int32(wp.clamp(wp.floor(high[0] - 0.5) + 1.0, 0.0, wp.float32(width)))
        bottom = wp.int32(wp.clamp(wp.floor(high[1] - 0.5) + 1.0, 0.0, wp.float32(height)))
        if left < right and top < bottom:
            box = wp.vec4i(left, top, right, bottom)
    boxes[frame, face] = box


@wp.func
def _draw(
    frame: wp.int32,
    face: wp.int32,
    top: wp.int32,
    bottom: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    boxes: wp.array2d[wp.vec4i],
    width: wp.int32,
    height: wp.int32,
    nearest: wp.array[wp.int64],
) -> None:
    """Put one triangle's key into the pixels that it covers, in the rows from ``top`` to ``bottom``."""
    box = boxes[frame, face]
    if wp.max(box[1], top) >= wp.min(box[3], bottom):
        return
    corners = face_corners(faces, face)
    a = points[frame, corners[0]]
    b = points[frame, corners[1]]
    c = points[frame, corners[2]]
    reciprocals = wp.vec3(1.0 / a[2], 1.0 / b[2], 1.0 / c[2])
    for row in range(wp.max(box[1], top), wp.min(box[3], bottom)):
        line = (frame * height + row) * width
        for column in range(box[0], box[2]):
            p = wp.vec2(wp.float32(column) + 0.5, wp.float32(row) + 0.5)
            weights = screen_weights(corners, a, b, c, p)
            if wp.min(weights) >= 0.0 or wp.max(weights) <= 0.0:
                # the reciprocal of the depth is linear on the screen
                depth = (weights[0] + weights[1] + weights[2]) / wp.dot(weights, reciprocals)
                # false of a triangle without area
                if depth > 0.0:
                    wp.atomic_min(nearest, line + column, key_of(depth, face))


@wp.kernel(enable_backward=False)
def _draw_triangle(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    boxes: wp.array2d[wp.vec4i],
    width: wp.int32,
    height: wp.int32,
    nearest: wp.array[wp.int64],
) -> None:
    """One triangle of one frame."""
    index = first + wp.tid()
    frame = index // faces.shape[0]
    _draw(frame, index - frame * faces.shape[0], 0, height, points, faces, boxes, width, height, nearest)


@wp.kernel(enable_backward=False)
def _draw_band(
    first: wp.int32,
    bands: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    boxes: wp.array2d[wp.vec4i],
    width: wp.int32,
    height: wp.int32,
    nearest: wp.array[wp.int64],
) -> None:
    """All triangles in one band of rows of one frame: no other thread writes there."""
    index = first + wp.tid()
    frame = index // bands
    band = index - frame * bands
    top = band * height // bands
    bottom = (band + 1) * height // bands
    for face in range(faces.shape[0]):
        _draw(frame, face, top, bottom, points, faces, boxes, width, height, nearest)


@wp.kernel(enable_backward=False)
def _resolve(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    nearest: wp.array[wp.int64],
    face: wp.array[wp.int32],
    barycentrics: wp.array[wp.vec3],
    is_seen: wp.array2d[wp.bool],
) -> None:
    """One pixel: the triangle in its key, and the centre's place in it."""
    index = first + wp.tid()
    key = nearest[index]
    if key == NOTHING:
        face[index] = -1
        barycentrics[index] = wp.vec3(0.0)
        return
    line = index // width
    frame = line // height
    p = wp.vec2(wp.float32(index - line * width) + 0.5, wp.float32(line - frame * height) + 0.5)
    shown = key_index(key)
    corners = face_corners(faces, shown)
    a = points[frame, corners[0]]
    b = points[frame, corners[1]]
    c = points[frame, corners[2]]
    weights = wp.cw_div(screen_weights(corners, a, b, c, p), wp.vec3(a[2], b[2], c[2]))
    # whichever pixel comes first, they write the same
    is_seen[frame, shown] = True
    face[index] = shown
    barycentrics[index] = weights / (weights[0] + weights[1] + weights[2])


@wp.kernel(enable_backward=False)
def _empty_hidden(first: wp.int32, is_seen: wp.array2d[wp.bool], boxes: wp.array2d[wp.vec4i]) -> None:
    """One triangle of one frame: no pixels, where none shows it."""
    index = first + wp.tid()
    frame = index // boxes.shape[1]
    face = index - frame * boxes.shape[1]
    if not is_seen[frame, face]:
        boxes[frame, face] = wp.vec4i(0)


@wp.kernel(enable_backward=False)
def _gather_corners(
    first: wp.int32,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    boxes: wp.array2d[wp.vec4i],
    width: wp.int32,
    height: wp.int32,
    face: wp.array[wp.int32],
    grad_barycentrics: wp.array[wp.vec3],
    grad_corners: wp.array2d[wp.vec3],
) -> None:
    """One triangle of one frame: what its pixels' gradients say of its three corners."""
    index = first + wp.tid()
    frame = index // faces.shape[0]
    shown = index - frame * faces.shape[0]
    grad_a = wp.vec3(0.0)
    grad_b = wp.vec3(0.0)
    grad_c = wp.vec3(0.0)
    box = boxes[frame, shown]
    if box[0] < box[2]:
        corners = face_corners(faces, shown)
        a = points[frame, corners[0]]
        b = points[frame, corners[1]]
        c = points[frame, corners[2]]
        depths = wp.vec3(a[2], b[2], c[2])
        for row in range(box[1], box[3]):
            line = (frame * height + row) * width
            for column in range(box[0], box[2]):
                if face[line + column] != shown:
                    continue
                # the forward pass again: u_i = w_i / z_i, and the barycentrics b_i = u_i / sum of u
                p = wp.vec2(wp.float32(column) + 0.5, wp.float32(row) + 0.5)
                u = wp.cw_div(screen_weights(corners, a, b, c, p), depths)
                total = u[0] + u[1] + u[2]
                # dL/du_i = (dL/db_i - sum of b_j dL/db_j) / sum of u
                grad = grad_barycentrics[line + column]
                grad_u = (grad - wp.vec3(wp.dot(grad, u) / total)) / total
                # dL/dw_i and dL/dz_i; w_i is twice the area across from corner i, seen from p
                grad_w = wp.cw_div(grad_u, depths)
                grad_z = -wp.cw_mul(grad_w, u)
                a_x, a_y = a[0] - p[0], a[1] - p[1]
                b_x, b_y = b[0] - p[0], b[1] - p[1]
                c_x, c_y = c[0] - p[0], c[1] - p[1]
                grad_a += wp.vec3(
                    grad_w[2] * b_y - grad_w[1] * c_y, grad_w[1] * c_x - grad_w[2] * b_x, grad_z[0]
                )
                grad_b += wp.vec3(
                    grad_w[0] * c_y - grad_w[2] * a_y, grad_w[2] * a_x - grad_w[0] * c_x, grad_z[1]
                )
                grad_c += wp.vec3(
                    grad_w[1] * a_y - grad_w[0] * b_y, grad_w[0] * b_x - grad_w[1] * a_x, grad_z[2]
                )
    grad_corners[frame, 3 * shown] = grad_a
    grad_corners[frame, 3 * shown + 1] = grad_b
    grad_corners[frame, 3 * shown + 2] = grad_c
