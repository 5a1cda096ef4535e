"""Where a camera's pixels look and are lit from, in the axes of a light that is turned.

Deferred shading takes unit vectors to the camera. Where nothing is differentiated, they are made here, of
pixels that show something alone, together with the normals in the light's axes, instead of by torch over the
whole image.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors

GRAIN = 8192
"""Pixels that are worth a thread."""

_COVERED = wp.constant(COVERED_ALPHA)


class Aimed(NamedTuple):
    """Directions of H W pixels in a light's axes; zero where next to nothing covers a pixel.

    Attributes:
        view: (H W, 3) float32 unit vectors to the camera.
        normal: (H W, 3) float32 normals.
    """

    view: Tensor
    normal: Tensor


def aim(normal: Tensor, alpha: Tensor, camera: Camera, *, rotate: float) -> Aimed:
    """Turn pixels' normals, and the vectors from them to the camera, against a turned light.

    Args:
        normal: (H W, 3) float32 in the world's axes, row by row.
        alpha: (H W, 1) float32 coverage; below 1/255 there is no surface.
        camera: The view, on the same device.
        rotate: Degrees by which the light is turned about the vertical, as `Environment.rotate`.

    Returns:
        Directions; constants.

    Raises:
        UserError: A tensor has another shape, dtype or device, or the image is not the camera's.
    """
    check_tensors(
        ("normal", normal, ("M", 3)),
        ("alpha", alpha, ("M", 1)),
        ("camera.world_to_camera", camera.world_to_camera, (4, 4)),
    )
    if len(normal) != camera.width * camera.height:
        raise UserError(
            "normal", expected=f"{camera.width} x {camera.height} pixels of the camera", found=len(normal)
        )
    aimed = Aimed(torch.empty_like(normal), torch.empty_like(normal))
    angle = math.radians(rotate)
    focal, principal = wp.vec2(camera.fx, camera.fy), wp.vec2(camera.cx, camera.cy)
    turn = wp.vec2(math.cos(angle), math.sin(angle))
    inputs = (normal.detach().contiguous(), alpha.detach().reshape(-1), camera.world_to_camera.contiguous())
    lens = (camera.width, focal, principal, turn)
    launch_range(_aim, len(normal), *inputs, *lens, *aimed, grain=GRAIN)
    return aimed


@wp.func
def _turned(direction: wp.vec3, turn: wp.vec2) -> wp.vec3:
    """Where a light as it was is looked up for a direction, once it is turned by (cosine, sine)."""
    return wp.vec3(
        turn[0] * direction[0] - turn[1] * direction[2],
        direction[1],
        turn[1] * direction[0] + turn[0] * direction[2],
    )


@wp.kernel(enable_backward=False)
def _aim(
    first: wp.int32,
    normal: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    pose: wp.array2d[wp.float32],
    width: wp.int32,
    focal: wp.vec2,
    principal: wp.vec2,
    turn: wp.vec2,
    view: wp.array[wp.vec3],
    turned: wp.array[wp.vec3],
) -> None:
    """One pixel."""
    m = first + wp.tid()
    if alpha[m] < _COVERED:
        view[m] = wp.vec3()
        turned[m] = wp.vec3()
        return
    row = m // width
    x = (wp.float32(m - row * width) + 0.5 - principal[0]) / focal[0]
    y = (wp.float32(row) + 0.5 - principal[1]) / focal[1]
    ray = wp.normalize(wp.vec3(x, y, 1.0))
    # against the ray, by the transpose of the camera's rotation
    toward = wp.vec3(
        -(ray[0] * pose[0, 0] + ray[1] * pose[1, 0] + ray[2] * pose[2, 0]),
        -(ray[0] * pose[0, 1] + ray[1] * pose[1, 1] + ray[2] * pose[2, 1]),
        -(ray[0] * pose[0, 2] + ray[1] * pose[1, 2] + ray[2] * pose[2, 2]),
    )
    view[m] = _turned(toward, turn)
    turned[m] = _turned(normal[m], turn)
