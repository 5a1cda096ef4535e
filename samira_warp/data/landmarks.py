"""The landmarks that a detector found in a dataset's pictures, where whoever prepared it left them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from samira_warp.head.landmarks import LANDMARKS, MESH_LANDMARKS
from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError

LANDMARKS_FILE = "landmarks.npz"
"""In a dataset's folder; no dataset has to have it."""


@dataclass(frozen=True, eq=False)
class DetectedLandmarks:
    """Landmarks of the face mesh in N pictures.

    Attributes:
        names: N names of frames.
        points: (N, 478, 2) float32 pixels x and y, the irises' last; NaN where there is none.
    """

    names: tuple[str, ...]
    points: np.ndarray

    def of(self, name: str) -> np.ndarray | None:
        """(478, 2) the points of a frame, None where it has none at all."""
        if name not in self.names:
            return None
        points = self.points[self.names.index(name)]
        return points if np.isfinite(points).any() else None


def read_landmarks(root: Path) -> DetectedLandmarks | None:
    """Read a dataset's `LANDMARKS_FILE`; None where it has none.

    It holds landmarks (N, 468, 3), x, y and z in pixels of the pictures, irises (N, 2, 5, 2), the subject's
    right eye first, seen (N,), whether a face was seen, and stems (N,), the pictures' names without suffix.
    Nothing in it is unpickled.

    Raises:
        UserError: The file is broken, lacks an array, or has one of a wrong shape or kind.
    """
    path = root / LANDMARKS_FILE
    if not path.is_file():
        return None
    arrays = read_npz(path, wanted=_SHAPES.__contains__)
    count = len(arrays["stems"]) if arrays.get("stems", np.zeros(())).ndim == 1 else 0
    for key, (shape, kinds, what) in _SHAPES.items():
        if key not in arrays:
            raise UserError(f"{path}: {key}", expected="an array", found="no such key")
        array = arrays[key]
        if array.shape != (count, *shape) or array.dtype.kind not in kinds:
            dimensions = ", ".join(map(str, (count, *shape)))
            found = f"{array.dtype} of shape {array.shape}"
            raise UserError(f"{path}: {key}", expected=f"{what} of shape ({dimensions})", found=found)
    irises = arrays["irises"].reshape(count, LANDMARKS - MESH_LANDMARKS, 2)
    points = np.concatenate([arrays["landmarks"][..., :2], irises], axis=1).astype(np.float32)
    points[~arrays["seen"].astype(bool)] = np.nan
    points[~np.isfinite(points).all(axis=2)] = np.nan
    return DetectedLandmarks(tuple(map(str, arrays["stems"])), points)


_SHAPES = {
    "stems": ((), "U", "names"),
    "seen": ((), "biuf", "whether a face was seen"),
    "landmarks": ((MESH_LANDMARKS, 3), "f", "points"),
    "irises": ((2, (LANDMARKS - MESH_LANDMARKS) // 2, 2), "f", "points"),
}
"""Shapes after the first dimension, kinds of numbers and what they are, of every array that is read."""
