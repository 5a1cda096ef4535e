"""Cube crosses, and cubemaps at another size or turn.

A cross shows the world as it is seen from within, and the same way round as a panorama: straight ahead of the
camera (-z) in the middle, +x on its right, up above. That is OpenGL's cross (+Y above, -X, +Z, +X, -Z in a
row, -Y below) in OpenGL's left-handed axes, whose z points the other way. An upright cross has the face
behind below the bottom one, upside down.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import FACES, texel_directions, texel_solid_angles
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.light.equirect import turn_directions
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor

_COLUMNS, _ROWS = 1, 0
"""The axis along which a face is mirrored between a cubemap in OpenGL's orientation and a cross that is seen
from within."""

_LYING = (
    (1, 2, _COLUMNS),
    (1, 0, _COLUMNS),
    (0, 1, _ROWS),
    (2, 1, _ROWS),
    (1, 3, _COLUMNS),
    (1, 1, _COLUMNS),
)
"""Row, column and mirrored axis of each face, +x to -z, in a cross of 4 x 3 faces."""

_UPRIGHT = (*_LYING[:4], (3, 1, _ROWS), _LYING[5])
"""The same in a cross of 3 x 4 faces: the face behind is turned by half a turn, which mirrors its other
axis."""


def is_cross(height: int, width: int) -> bool:
    """Whether a picture of this size can be a cross: 4 x 3 or 3 x 4 square faces."""
    return 3 * width == 4 * height or 4 * width == 3 * height


def cross_to_cube(cross: Tensor) -> Tensor:
    """The faces of a cross (3 S, 4 S, C) or (4 S, 3 S, C) as a cubemap (6, S, S, C), texel for texel.

    What is beside them is not looked at.

    Raises:
        UserError: It is no cross.
    """
    check_tensor("cross", cross, shape=("H", "W", "C"), dtype=None)
    height, width = cross.shape[:2]
    if not is_cross(height, width):
        raise UserError("cross", expected="4 x 3 or 3 x 4 square faces", found=f"{width} x {height}")
    places, size = (_LYING, width // 4) if width > height else (_UPRIGHT, width // 3)
    faces = [
        cross[row * size : (row + 1) * size, column * size : (column + 1) * size].flip(axis)
        for row, column, axis in places
    ]
    return torch.stack(faces)


def cube_to_cross(cubemap: Tensor) -> Tensor:
    """A cubemap (6, S, S, C) as a lying cross (3 S, 4 S, C), texel for texel; 0 beside the faces."""
    check_tensor("cubemap", cubemap, shape=(FACES, "S", "S", "C"), dtype=None)
    size = cubemap.shape[1]
    cross = cubemap.new_zeros(3 * size, 4 * size, cubemap.shape[3])
    for face, (row, column, axis) in zip(cubemap, _LYING, strict=True):
        cross[row * size : (row + 1) * size, column * size : (column + 1) * size] = face.flip(axis)
    return cross


def resample_cube(cubemap: Tensor, *, size: int, rotate: float = 0.0) -> Tensor:
    """A cubemap at another size, or turned; each texel is the mean over its solid angle.

    A map whose size is a multiple of the new one, and that is not turned, is averaged exactly in whole
    blocks; any other is averaged in blocks as far as they go and then sampled at least twice as densely as
    its texels.

    Args:
        cubemap: (6, S, S, C) float32, linear.
        size: The new S.
        rotate: Degrees by which the light turns (`equirect.turn_directions`).

    Returns:
        (6, size, size, C) float32; ``cubemap`` itself where nothing changes.
    """
    check_tensor("cubemap", cubemap, shape=(FACES, "S", "S", "C"))
    cubemap = _shrink(cubemap, at_least=size)
    if cubemap.shape[1] == size and rotate % 360.0 == 0.0:
        return cubemap
    samples = max(2, math.ceil(2 * cubemap.shape[1] / size))
    directions = texel_directions(size, device=cubemap.device, supersample=samples)
    directions = turn_directions(directions, rotate).view(FACES, size, samples, size, samples, 3)
    areas = texel_solid_angles(size * samples, device=cubemap.device).view(size, samples, size, samples)
    total = cubemap.new_zeros(FACES, size, size, cubemap.shape[3])
    for j in range(samples):
        for i in range(samples):
            seen = sample_cubemap(cubemap, directions[:, :, j, :, i].reshape(-1, 3))
            total = total + areas[:, j, :, i, None] * seen.view_as(total)
    return total / areas.sum(dim=(1, 3))[..., None]


def _shrink(cubemap: Tensor, *, at_least: int) -> Tensor:
    """Average whole blocks of texels, weighted by solid angle, while faces keep at least so many columns."""
    size = cubemap.shape[1]
    factor = max((f for f in range(1, size // at_least + 1) if size % f == 0), default=1)
    if factor == 1:
        return cubemap
    shape = (size // factor, factor, size // factor, factor)
    areas = texel_solid_angles(size, device=cubemap.device).view(*shape, 1)
    blocks = cubemap.view(FACES, *shape, cubemap.shape[3])
    return (blocks * areas).sum(dim=(2, 4)) / areas.sum(dim=(1, 3))
