"""Make samira_warp/assets/face_mesh.npz: the face mesh network's mean shape, and which points mirror which.

usage: python tools/make_face_mesh.py --pictures DIR [--models DIR]

The pictures show a face each, such as the built-in subject's. A point's mirror image is the point that the
network reads in its place in the mirrored picture, over all of them; the shape is the mean of the readings,
each turned, moved and scaled onto the others, and of its own mirror image.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

import samira_warp
from samira_warp.io.images import read_image
from samira_warp.support.cli import run
from samira_warp.vision.crops import Square
from samira_warp.vision.detector import detect_faces
from samira_warp.vision.face_shape import LEFT_EYE_OUTER, align
from samira_warp.vision.faces import CROP
from samira_warp.vision.mesh import read_unnamed, square_about
from samira_warp.vision.networks import FaceNetworks

TARGET = Path(samira_warp.__file__).parent / "assets" / "face_mesh.npz"

ROUNDS = 5
"""Of laying the readings on their mean and taking it again; the fourth changes nothing any more."""


@dataclass(frozen=True)
class FaceMeshConfig:
    """Make the face mesh's mean shape and mirror images from pictures of faces."""

    pictures: Path
    """Folder of .png files with a face each."""
    models: Path | None = None
    """Folder of the network files; without it they are fetched."""


def make(config: FaceMeshConfig) -> None:
    """Write the file."""
    networks = FaceNetworks.load(config.models)
    readings = [
        pair
        for path in sorted(config.pictures.glob("*.png"))
        for pair in _read(networks, np.rint(read_image(path, channels=3) * 255.0).astype(np.uint8))
    ]
    straight, mirrored = (np.stack(side) for side in zip(*readings, strict=True))
    mirror = _mirror(straight, mirrored)
    shape = _mean(np.concatenate([straight, mirrored[:, mirror]]), mirror)
    np.savez_compressed(TARGET, shape=shape.astype(np.float32), mirror=mirror.astype(np.int16))
    print(f"{TARGET}: from {len(readings)} pictures")


def _read(networks: FaceNetworks, picture: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """A face's points (468, 3) in its own square, and in that one's mirror image; nothing without a face."""
    faces = detect_faces(networks.detector, picture)
    if not faces:
        return []
    face = faces[0]
    x, y = (face.box[:2] + face.box[2:]) / 2
    square = Square(float(x), float(y), CROP * face.size, face.roll)
    for _ in range(3):
        square = square_about(read_unnamed(networks.mesh, picture, square).landmarks)
    squares = (square, replace(square, mirrored=True))
    straight, mirrored = (read_unnamed(networks.mesh, picture, side).landmarks for side in squares)
    return [(straight, mirrored)]


def _mirror(straight: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """(468,) int: whose place each point takes in the mirrored pictures; its own inverse."""
    scale = np.ptp(straight[..., :2], axis=(1, 2), keepdims=True)
    apart = np.zeros((straight.shape[1],) * 2)
    for one, other, size in zip(straight, mirrored, scale, strict=True):
        apart += np.linalg.norm((one[:, None] - other[None]) / size, axis=2)
    mirror = linear_sum_assignment(apart)[1]
    assert np.array_equal(mirror[mirror], np.arange(len(mirror)))
    return mirror


def _mean(readings: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """(468, 3) their mean shape, symmetric, of root mean square radius 1."""
    shape = readings[0] - readings[0].mean(axis=0)
    for _ in range(ROUNDS):
        laid = []
        for reading in readings:
            aligned = align(reading, shape)
            laid.append((reading - reading.mean(axis=0)) @ aligned.turn / aligned.scale)
        shape = np.mean(laid, axis=0)
        shape = shape @ _frontal(shape, mirror)
        shape = (shape + shape[mirror] * [-1.0, 1.0, 1.0]) / 2
        shape /= np.sqrt((shape**2).sum(axis=1).mean())
    return shape


def _frontal(shape: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """(3, 3) axes in columns: x from right to left through the head, y as far down as it was."""
    _, _, directions = np.linalg.svd(shape - shape[mirror], full_matrices=False)
    x = directions[0] * np.sign(directions[0] @ (shape - shape[mirror])[LEFT_EYE_OUTER])
    y = np.array([0.0, 1.0, 0.0]) - x * x[1]
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


if __name__ == "__main__":
    sys.exit(run(make, FaceMeshConfig, program="python tools/make_face_mesh.py"))
