"""The face mesh's mean shape, which points are each other's mirror images, and how far a reading is from it.

`assets/face_mesh.npz` was made from the network's own readings of the built-in subject's pictures
(`tools/make_face_mesh.py`): no other mesh is part of this project.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import samira_warp

LEFT_EYE_OUTER, RIGHT_EYE_OUTER = 263, 33
"""Outer corners of the subject's eyes: the eye line is from the right one to the left one."""


class FaceShape(NamedTuple):
    """A face that is nobody's.

    Attributes:
        points: (468, 3) float64, x to the picture's right, y down, z away from the camera, upright and
            frontal; centred, of root mean square radius 1.
        mirror: (468,) int64 by point, its mirror image's number.
    """

    points: np.ndarray
    mirror: np.ndarray


@cache
def face_shape() -> FaceShape:
    """The shape that comes with the package."""
    path = Path(samira_warp.__file__).parent / "assets" / "face_mesh.npz"
    with np.load(path, allow_pickle=False) as archive:
        return FaceShape(archive["shape"].astype(np.float64), archive["mirror"].astype(np.int64))


class Aligned(NamedTuple):
    """The mean shape laid on landmarks, as well as turning, moving and scaling it can.

    Attributes:
        turn: (3, 3) float64 rotation from the mean shape's axes to the picture's.
        scale: Pixels of the mean shape's unit.
        residual: Root mean square distance that is left, in units of the mean shape.
    """

    turn: np.ndarray
    scale: float
    residual: float


def align(landmarks: np.ndarray, shape: np.ndarray | None = None) -> Aligned:
    """Lay the mean shape, or another one (468, 3), on landmarks (468, 3) in pixels (Umeyama 1991)."""
    shape = face_shape().points if shape is None else shape
    centred = landmarks - landmarks.mean(axis=0)
    u, spread, v = np.linalg.svd(centred.T @ shape)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    turn = (u * signs) @ v
    scale = float((spread * signs).sum() / (shape**2).sum())
    left = centred - scale * shape @ turn.T
    residual = float(np.sqrt((left**2).sum(axis=1).mean())) / max(scale, 1e-9)
    return Aligned(turn, scale, residual)


def roll_of(landmarks: np.ndarray) -> float:
    """Radians from the picture's x axis to the eye line, towards y."""
    across = landmarks[LEFT_EYE_OUTER, :2] - landmarks[RIGHT_EYE_OUTER, :2]
    return float(np.arctan2(across[1], across[0]))
