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


def yaw_of(landmarks: np.ndarray) -> float:
    """Radians that a head is turned from the camera, towards the picture's right where positive."""
    turn = align(landmarks).turn
    return float(np.arctan2(-turn[0, 2], turn[2, 2]))


def facing(landmarks: np.ndarray) -> np.ndarray:
    """(468,) float64 cosines between the directions to the camera and of a face's normals.

    The normals are the mean shape's, turned as the face is. Negative where a point is on the side that is
    turned away.

    Args:
        landmarks: (468, 3) pixels.
    """
    return -_normals() @ align(landmarks).turn[2]


def confidence(landmarks: np.ndarray) -> np.ndarray:
    """(468,) float64 0..1 by how much landmarks are to be believed, as the inverse of their deviation.

    Against the surfaces of two rendered heads the network's points are off by 1.3 units where their surface
    faces the camera by a cosine of 0.5 and more, by 1.6 at 0.2, 2.2 at 0, and by 3.3 below -0.2, where they
    slide along the silhouette, together and by the same amount in picture after picture: no average helps.
    Hence faster than the inverse of these, from 1 at 0.5 to nothing at -0.3.

    Args:
        landmarks: (468, 3) pixels.
    """
    return np.clip((facing(landmarks) + 0.3) / 0.8, 0.0, 1.0)


@cache
def _normals() -> np.ndarray:
    """(468, 3) float64 unit normals of the mean shape, outwards, by the planes through nine points each."""
    points = face_shape().points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    nearby = points[np.argsort(apart, axis=1)[:, :9]]
    _, _, axes = np.linalg.svd(nearby - nearby.mean(axis=1, keepdims=True))
    outwards = points - np.array([0.0, 0.0, points[:, 2].max()])
    return axes[:, 2] * np.sign((axes[:, 2] * outwards).sum(axis=1))[:, None]
