"""What HRAvatar and IMavatar share, both tracked by an optimisation over DECA.

Their cameras are of an enlarged head and have OpenGL's axes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from samira_warp.data.film import Intrinsics
from samira_warp.data.numbers import numbers, world_to_camera
from samira_warp.head.joints import FLAME_JOINTS
from samira_warp.support.errors import UserError

_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def pose_in_metres(place: object, value: object, *, scale: float) -> np.ndarray:
    """(4, 4) world to camera in metres with OpenCV's axes.

    Args:
        place: File and key, for what is said about them.
        value: A ``world_mat`` that looks along -z.
        scale: How many times as large the head is that it looks at.

    Raises:
        UserError: ``value`` is no rigid transform.
    """
    matrix = _TO_OPENCV @ world_to_camera(place, value)
    matrix[:3, 3] /= scale
    return matrix


def intrinsics_of(
    place: object, value: object, *, pixels_of: float | None
) -> Callable[[int, int, int], Intrinsics]:
    """The camera of ``[fx, fy, cx, cy]``.

    They are shares of the picture's size, or pixels where the centre is beyond 1. A focal length may be
    negative: these trackers divide by a depth that is.

    Args:
        place: File and key, for what is said about them.
        value: The four numbers.
        pixels_of: Width and height of the picture whose pixels they are, None for the picture that comes.

    Raises:
        UserError: ``value`` is something else.
    """
    fx, fy, cx, cy = numbers(place, value, (4,))
    if fx == 0 or fy == 0 or cx <= 0 or cy <= 0:
        raise UserError(place, expected="[fx, fy, cx, cy] other than zero", found=[fx, fy, cx, cy])
    in_pixels = max(cx, cy) > 1

    def intrinsics(_: int, width: int, height: int) -> Intrinsics:
        x, y = (
            (width, height)
            if not in_pixels
            else (1.0, 1.0)
            if pixels_of is None
            else (width / pixels_of, height / pixels_of)
        )
        return Intrinsics(abs(fx) * x, abs(fy) * y, cx * x, cy * y)

    return intrinsics


def pose_of(place: object, value: object) -> np.ndarray:
    """(5, 3) axis-angles of FLAME's joints, of 15 numbers.

    Raises:
        UserError: ``value`` is something else.
    """
    return numbers(place, value, (3 * len(FLAME_JOINTS),)).reshape(-1, 3)


def poses_by_joint(rows: np.ndarray) -> dict[str, np.ndarray]:
    """(T, 3) axis-angles by joint, of (T, 5, 3)."""
    return {name: rows[:, joint] for joint, name in enumerate(FLAME_JOINTS)}
