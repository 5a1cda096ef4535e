"""Where the points of the face mesh that detectors find lie on a head's surface.

The points are those of MediaPipe's face mesh: 0 to 467, and 468 to 477 for the irises (`docs/heads.md`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError

MESH_LANDMARKS = 468
"""Points of the face mesh, without the irises."""

LANDMARKS = 478
"""Points of the face mesh and, after them, five for each iris: its centre and four on its edge, the subject's
right eye first."""

EMBEDDING_FILE = "mediapipe_landmark_embedding.npz"
"""The file that goes with FLAME: 105 of the 468 points, as face and barycentric coordinates."""

_FLAME_KEYS = ("landmark_indices", "lmk_face_idx", "lmk_b_coords")
"""Its arrays, in the order of `LandmarkEmbedding`'s fields."""

SUM_ERROR = 1e-3
"""How far a point's barycentric coordinates may sum from 1: FLAME's file has them rounded to float32."""


@dataclass(frozen=True, eq=False)
class LandmarkEmbedding:
    """Landmarks as points of a triangle mesh; they move with it.

    Attributes:
        ids: (L,) int32 which of the `LANDMARKS` points each is, all different.
        faces: (L,) int32 the face that each lies on.
        barycentrics: (L, 3) float32 weights of that face's corners, each row summing to 1.
    """

    ids: np.ndarray
    faces: np.ndarray
    barycentrics: np.ndarray

    def __len__(self) -> int:
        """L, how many points there are."""
        return len(self.ids)

    def points(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Where the landmarks are on a posed head.

        Args:
            vertices: (..., V, 3) vertices of one head or many.
            faces: (F, 3) integer vertex ids.

        Returns:
            (..., L, 3) in the vertices' precision.
        """
        corners = vertices[..., faces[self.faces], :]
        return (self.barycentrics[..., None].astype(vertices.dtype) * corners).sum(axis=-2)

    def only(self, ids: np.ndarray) -> LandmarkEmbedding:
        """The points of some ids, in the embedding's order; ids that it does not have are left out."""
        kept = np.isin(self.ids, ids)
        return LandmarkEmbedding(self.ids[kept], self.faces[kept], self.barycentrics[kept])


def read_landmark_embedding(path: str | Path, *, faces: int) -> LandmarkEmbedding:
    """Read the landmark file that people have for FLAME (`EMBEDDING_FILE`).

    It holds landmark_indices (L,), lmk_face_idx (L,) and lmk_b_coords (L, 3); nothing in it is unpickled.

    Args:
        path: The file.
        faces: F, how many faces the head has whose surface the points lie on.

    Raises:
        UserError: The file is missing or broken, or an array of it has a wrong shape or values out of range.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(path, expected="an npz file of landmarks", found="no such file")
    arrays = read_npz(path, wanted=lambda key: key in _FLAME_KEYS)
    for key in _FLAME_KEYS:
        if key not in arrays:
            raise UserError(f"{path}: {key}", expected="an array", found="no such key")
    return checked_embedding(
        path, dict(zip(_FLAME_KEYS, (arrays[key] for key in _FLAME_KEYS), strict=True)), faces
    )


def checked_embedding(path: Path, arrays: dict[str, np.ndarray], faces: int) -> LandmarkEmbedding:
    """An embedding of three arrays: ids, faces, barycentric coordinates.

    Args:
        path: Where they were read, for what is said about them.
        arrays: The arrays by the names that their file gives them, in that order.
        faces: F, how many faces there are.

    Raises:
        UserError: One has a wrong shape, dtype or value.
    """
    (ids_key, ids), (faces_key, face_ids), (weights_key, weights) = arrays.items()
    count = len(ids) if ids.ndim == 1 else 0
    _check_integers(f"{path}: {ids_key}", ids, shape=(count,), below=LANDMARKS)
    if len(np.unique(ids)) != count:
        raise UserError(f"{path}: {ids_key}", expected="ids that differ", found="one twice")
    _check_integers(f"{path}: {faces_key}", face_ids, shape=(count,), below=faces)
    wanted = f"finite weights of shape ({count}, 3), each row summing to 1"
    if weights.shape != (count, 3) or weights.dtype.kind != "f":
        found = f"{weights.dtype} of shape {weights.shape}"
        raise UserError(f"{path}: {weights_key}", expected=wanted, found=found)
    if not (np.abs(weights.sum(axis=1) - 1.0) <= SUM_ERROR).all():
        raise UserError(f"{path}: {weights_key}", expected=wanted, found="other sums")
    return LandmarkEmbedding(
        ids.astype(np.int32), face_ids.astype(np.int32), np.ascontiguousarray(weights, np.float32)
    )


def _check_integers(place: str, array: np.ndarray, *, shape: tuple[int, ...], below: int) -> None:
    wanted = f"integers from 0 to {below - 1}, one for each landmark"
    if array.shape != shape or array.dtype.kind not in "iu":
        raise UserError(place, expected=wanted, found=f"{array.dtype} of shape {array.shape}")
    if array.size and not (array.min() >= 0 and array.max() < below):
        raise UserError(place, expected=wanted, found=f"{array.min()} to {array.max()}")
