"""The geometry of a cubemap: where its texels are, how large they are, and what lies over an edge.

A cubemap is a (6, S, S, C) tensor with OpenGL's face order (+x, -x, +y, -y, +z, -z) and orientation: texel
(face, row, column) is centred on the cube point ``major axis + s * column axis + t * row axis`` with s = (2
column + 1) / S - 1 and t = (2 row + 1) / S - 1. In integers: twice the texel's coordinates, times S / 2, are
odd numbers along the face and +-S along its axis; `texel_points` and `texel_index` convert, and everything
that has to do with neighbours and symmetry is exact arithmetic on those points.
"""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from samira_warp.support.caching import cached_tensors
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor

FACES = 6
"""Faces of a cube."""


def check_cubemap(
    name: str, cubemap: Tensor, *, channels: int | str = "C", device: torch.device | None = None
) -> None:
    """Raise UserError unless ``cubemap`` is (6, S, S, channels) float32, S at least 1, on ``device``."""
    check_tensor(name, cubemap, shape=(FACES, "S", "S", channels), device=device)
    if cubemap.shape[1] == 0:
        raise UserError(name, expected="at least one texel", found=tuple(cubemap.shape))


def face_axes(device: torch.device | str = "cpu") -> Tensor:
    """(6, 3, 3) int64 unit vectors of each face's columns (s), rows (t) and own axis: OpenGL's table."""
    return torch.tensor(
        [
            [[0, 0, -1], [0, -1, 0], [1, 0, 0]],
            [[0, 0, 1], [0, -1, 0], [-1, 0, 0]],
            [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
            [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
            [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
            [[-1, 0, 0], [0, -1, 0], [0, 0, -1]],
        ],
        device=device,
    )


def texel_points(size: int, device: torch.device | str = "cpu") -> Tensor:
    """(6, S, S, 3) int64 centres of the texels on the cube [-S, S]^3.

    They are +-S along the face's axis, and 1 - S, 3 - S, ..., S - 1 along its columns and rows.
    """
    axes = face_axes(device)[:, None, None]
    steps = 2 * torch.arange(size, device=device) + 1 - size
    t, s = torch.meshgrid(steps, steps, indexing="ij")
    return s[..., None] * axes[..., 0, :] + t[..., None] * axes[..., 1, :] + size * axes[..., 2, :]


def texel_index(points: Tensor, size: int) -> Tensor:
    """(...) int64 flat index, (face * S + row) * S + column, of the texels centred on points (..., 3).

    The points are as `texel_points` gives them.
    """
    axis = points.abs().argmax(dim=-1)
    face = 2 * axis + (points.gather(-1, axis[..., None])[..., 0] < 0)
    axes = face_axes(points.device)[face]
    s = (points * axes[..., 0, :]).sum(dim=-1)
    t = (points * axes[..., 1, :]).sum(dim=-1)
    return (face * size + (t + size - 1) // 2) * size + (s + size - 1) // 2


def texel_directions(
    size: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu", supersample: int = 1
) -> Tensor:
    """Unit directions through the texel centres of a cubemap, or through a grid within each texel.

    Args:
        size: S, texels along a face's edge.
        dtype: Floating type of the result.
        device: Where the result lives.
        supersample: k; with k > 1 the result is that of a map of size k S: row j k + b, column i k + a lie
            within texel (j, i).

    Returns:
        (6, k S, k S, 3) unit vectors.
    """
    points = texel_points(size * supersample, device).to(torch.float64)
    return torch.nn.functional.normalize(points, dim=-1).to(dtype)


def texel_solid_angles(
    size: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> Tensor:
    """(S, S) exact solid angles, steradians, of the texels of any one face; six times their sum is 4 pi.

    The four-corner formula: the solid angle of the rectangle from the face's centre to (s, t) is atan2(s t,
    sqrt(s^2 + t^2 + 1)).
    """
    edge = torch.linspace(-1.0, 1.0, size + 1, dtype=torch.float64, device=device)
    t, s = torch.meshgrid(edge, edge, indexing="ij")
    corner = torch.atan2(s * t, torch.sqrt(s * s + t * t + 1.0))
    return (corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]).to(dtype)


@cached_tensors()
def mip_table(sizes: tuple[int, ...], device: torch.device) -> Tensor:
    """(L, 3) int32 per mip of a packed chain: size, index of its first texel, of its first cell.

    Cells are counted as in `cell_index`.
    """
    rows, texel, cell = [], 0, 0
    for size in sizes:
        rows.append((size, texel, cell))
        texel += FACES * size * size
        cell += FACES * (size + 1) * (size + 1)
    return torch.tensor(rows, dtype=torch.int32, device=device)


@wp.struct
class FacePoint:
    """A point on a cube's face: ``s`` along its columns and ``t`` along its rows, -1 to 1."""

    face: wp.int32
    s: wp.float32
    t: wp.float32


@wp.func
def find_face(direction: wp.vec3) -> FacePoint:
    """The face that a direction meets, and where; on a tie x comes before y before z."""
    size = wp.vec3(wp.abs(direction[0]), wp.abs(direction[1]), wp.abs(direction[2]))
    axis = wp.int32(2)
    if size[0] >= size[1] and size[0] >= size[2]:
        axis = wp.int32(0)
    elif size[1] >= size[2]:
        axis = wp.int32(1)
    sign = wp.where(direction[axis] < 0.0, -1.0, 1.0)
    scale = 1.0 / size[axis]
    point = FacePoint()
    point.face = 2 * axis + wp.where(direction[axis] < 0.0, 1, 0)
    if axis == 0:
        point.s = -sign * direction[2] * scale
        point.t = -direction[1] * scale
    elif axis == 1:
        point.s = direction[0] * scale
        point.t = sign * direction[2] * scale
    else:
        point.s = sign * direction[0] * scale
        point.t = -direction[1] * scale
    return point


@wp.func
def find_face_adjoint(
    direction: wp.vec3, point: FacePoint, grad_s: wp.float32, grad_t: wp.float32
) -> wp.vec3:
    """Gradient with respect to the direction of `find_face`, from those with respect to s and t."""
    axis = point.face // 2
    sign = wp.where(point.face % 2 == 1, -1.0, 1.0)
    scale = 1.0 / wp.abs(direction[axis])
    along_s = scale * grad_s
    along_t = scale * grad_t
    major = -sign * (point.s * along_s + point.t * along_t)
    if axis == 0:
        return wp.vec3(major, -along_t, -sign * along_s)
    if axis == 1:
        return wp.vec3(along_s, major, sign * along_t)
    return wp.vec3(sign * along_s, -along_t, major)


@wp.func
def face_point(face: wp.int32, s: wp.int32, t: wp.int32, major: wp.int32) -> wp.vec3i:
    """The cube point of face coordinates, in any integer unit."""
    sign = wp.where(face % 2 == 1, -1, 1)
    axis = face // 2
    if axis == 0:
        return wp.vec3i(sign * major, -t, -sign * s)
    if axis == 1:
        return wp.vec3i(s, sign * major, sign * t)
    return wp.vec3i(sign * s, -t, sign * major)


@wp.func
def point_s(face: wp.int32, point: wp.vec3i) -> wp.int32:
    """The column coordinate of a cube point on a face: inverse of `face_point`."""
    sign = wp.where(face % 2 == 1, -1, 1)
    axis = face // 2
    if axis == 0:
        return -sign * point[2]
    if axis == 1:
        return point[0]
    return sign * point[0]


@wp.func
def point_t(face: wp.int32, point: wp.vec3i) -> wp.int32:
    """The row coordinate of a cube point on a face: inverse of `face_point`."""
    sign = wp.where(face % 2 == 1, -1, 1)
    if face // 2 == 1:
        return sign * point[2]
    return -point[1]


@wp.func
def neighbour_face(face: wp.int32, ds: wp.int32, dt: wp.int32) -> wp.int32:
    """The face over the edge in direction (ds, dt), one of which is +-1 and the other 0."""
    step = face_point(face, ds, dt, 0)
    if step[0] != 0:
        return wp.where(step[0] < 0, 1, 0)
    if step[1] != 0:
        return wp.where(step[1] < 0, 3, 2)
    return wp.where(step[2] < 0, 5, 4)


@wp.func
def texel_at(face: wp.int32, column: wp.int32, row: wp.int32, size: wp.int32) -> wp.int32:
    """Index of a texel whose column or row may be one step over an edge.

    It is -1 if both are: there three faces meet, and no texel is. Over an edge lies the neighbour's border
    texel with the same place along the edge: the point (S + 1, t, S), in units of half a texel, folds to (S,
    t, S - 1).
    """
    over_s = wp.where(column < 0, -1, wp.where(column >= size, 1, 0))
    over_t = wp.where(row < 0, -1, wp.where(row >= size, 1, 0))
    if over_s == 0 and over_t == 0:
        return (face * size + row) * size + column
    if over_s != 0 and over_t != 0:
        return -1
    s = wp.clamp(2 * column + 1 - size, -size, size)
    t = wp.clamp(2 * row + 1 - size, -size, size)
    point = face_point(face, s, t, size - 1)
    other = neighbour_face(face, over_s, over_t)
    return (other * size + (point_t(other, point) + size - 1) // 2) * size + (
        point_s(other, point) + size - 1
    ) // 2


@wp.struct
class Footprint:
    """The cell of four texel centres around a direction: a bilinear lookup's support.

    ``column`` and ``row`` are those of the cell's first texel, -1 to S - 1; ``x`` and ``y`` the place within
    it, 0 to 1.
    """

    face: wp.int32
    column: wp.int32
    row: wp.int32
    x: wp.float32
    y: wp.float32


@wp.func
def footprint(point: FacePoint, size: wp.int32) -> Footprint:
    """The cell of a point in a map of size S."""
    half = 0.5 * wp.float32(size)
    column = (point.s + 1.0) * half - 0.5
    row = (point.t + 1.0) * half - 0.5
    result = Footprint()
    result.face = point.face
    result.column = wp.clamp(wp.int32(wp.floor(column)), -1, size - 1)
    result.row = wp.clamp(wp.int32(wp.floor(row)), -1, size - 1)
    result.x = column - wp.float32(result.column)
    result.y = row - wp.float32(result.row)
    return result


@wp.func
def cell_texels(cell: Footprint, size: wp.int32) -> wp.vec4i:
    """The cell's texels, -1 for a cube's corner.

    In order: (column, row), (column + 1, row), (column, row + 1), (column + 1, row + 1).
    """
    return wp.vec4i(
        texel_at(cell.face, cell.column, cell.row, size),
        texel_at(cell.face, cell.column + 1, cell.row, size),
        texel_at(cell.face, cell.column, cell.row + 1, size),
        texel_at(cell.face, cell.column + 1, cell.row + 1, size),
    )


@wp.func
def cell_index(cell: Footprint, size: wp.int32) -> wp.int32:
    """Index of a cell among the 6 (S + 1)^2 of a map.

    A row of cells starts half a texel before its face and ends half a texel after.
    """
    return (cell.face * (size + 1) + cell.row + 1) * (size + 1) + cell.column + 1


@wp.func
def cell_count(size: wp.int32) -> wp.int32:
    """Cells of a map."""
    return 6 * (size + 1) * (size + 1)


@wp.func
def bilinear_weights(cell: Footprint) -> wp.vec4:
    """Weights of the cell's four texels."""
    return wp.vec4(
        (1.0 - cell.x) * (1.0 - cell.y), cell.x * (1.0 - cell.y), (1.0 - cell.x) * cell.y, cell.x * cell.y
    )


@wp.func
def spread_corner(weights: wp.vec4, texels: wp.vec4i) -> wp.vec4:
    """Where three faces meet, give each texel a third of the missing one's weight: it is their mean."""
    missing = wp.float32(0.0)
    for k in range(4):
        if texels[k] < 0:
            missing = weights[k] / 3.0
    result = wp.vec4()
    for k in range(4):
        result[k] = wp.where(texels[k] < 0, 0.0, weights[k] + missing)
    return result
