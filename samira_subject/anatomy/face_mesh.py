"""Where the points of the face mesh that detectors find lie on the mean head."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.eyes import EYE, IRIS_RADIUS, on_cornea
from samira_warp.geometry.closest import closest_points
from samira_warp.head.landmarks import MESH_LANDMARKS, LandmarkEmbedding

FILE = "face_mesh.csv"
"""The points 0 to 467, as `tools/place_landmarks.py` placed them: millimetres in the anatomy's own frame, and
a vertex of the face that each lies on. Lips touch, so a place alone would not say which lip it is on; faces
alone would not outlast another triangulation of the free skin."""


@cache
def _placed() -> tuple[np.ndarray, np.ndarray]:
    """(468,) vertex ids and (468, 3) places, in the landmarks' order."""
    text = (files("samira_subject") / FILE).read_text(encoding="utf-8")
    rows = sorted(csv.DictReader(text.splitlines()), key=lambda row: int(row["id"]))
    assert [int(row["id"]) for row in rows] == list(range(MESH_LANDMARKS))
    vertices = np.array([int(row["vertex"]) for row in rows])
    return vertices, np.array([[float(row[axis]) for axis in "xyz"] for row in rows])


def face_mesh(anatomy: Anatomy) -> LandmarkEmbedding:
    """All 478 landmarks on the head: the face's, and the irises'."""
    vertices, points = _placed()
    face_ids = np.arange(len(anatomy.faces))
    found = []
    for vertex, point in zip(vertices, points, strict=True):
        found.append(_on_faces(anatomy, face_ids[(anatomy.faces == vertex).any(axis=1)], point[None]))
    for side, sign in (("right", -1.0), ("left", 1.0)):
        of_eyeball = anatomy.is_part(f"{side}_eyeball")[anatomy.faces].all(axis=1)
        found.append(_on_faces(anatomy, face_ids[of_eyeball], _iris(sign)))
    faces, barycentrics = (np.concatenate(part) for part in zip(*found, strict=True))
    return LandmarkEmbedding(
        np.arange(len(faces), dtype=np.int32), faces.astype(np.int32), barycentrics.astype(np.float32)
    )


def _on_faces(anatomy: Anatomy, face_ids: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of some faces nearest to (N, 3) points: (N,) face ids and (N, 3) barycentric coordinates."""
    nearest = closest_points(points, anatomy.points, anatomy.faces[face_ids])
    return face_ids[nearest.faces], nearest.barycentrics


def _iris(sign: float) -> np.ndarray:
    """(5, 3) the middle of an iris, then its edge on the picture's right, above, on its left and below.

    The picture's right is the subject's left, for both eyes; ``sign`` is -1 for the right one.
    """
    turns = 0.5 * np.pi * np.arange(4)
    flat = IRIS_RADIUS * np.column_stack([np.cos(turns), np.sin(turns)])
    return on_cornea(np.concatenate([np.zeros((1, 2)), flat])) + EYE * (sign, 1.0, 1.0)
