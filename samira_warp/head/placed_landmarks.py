"""Landmarks that were placed on a head once and are kept as text: places on its mean mesh."""

from __future__ import annotations

import csv
from importlib.resources import files
from pathlib import Path

import numpy as np

from samira_warp.geometry.closest import closest_points
from samira_warp.head.landmarks import LandmarkEmbedding


def placed_landmarks(file: str, package: str, points: np.ndarray, faces: np.ndarray) -> LandmarkEmbedding:
    """Read landmarks, and find the faces that they lie on.

    A row is a landmark's id, a vertex of the face that it lies on, and its place x, y, z in millimetres. Lips
    touch, so a place alone would not say which lip it is on; faces alone would not outlast another
    triangulation.

    Args:
        file: A .csv file with the columns id, vertex, x, y, z.
        package: The package in whose folder it lies.
        points: (V, 3) mean head, metres.
        faces: (F, 3) integer vertex ids.
    """
    text = (files(package) / file).read_text(encoding="utf-8")
    rows = sorted(csv.DictReader(text.splitlines()), key=lambda row: int(row["id"]))
    found = []
    for row in rows:
        place = np.array([[float(row[axis]) for axis in "xyz"]]) / 1000.0
        about = np.flatnonzero((faces == int(row["vertex"])).any(axis=1))
        found.append(on_faces(place, points, faces, about))
    face_ids, barycentrics = (np.concatenate(part) for part in zip(*found, strict=True))
    return LandmarkEmbedding(
        np.array([int(row["id"]) for row in rows], np.int32),
        face_ids.astype(np.int32),
        barycentrics.astype(np.float32),
    )


def write_placed(path: Path, landmarks: LandmarkEmbedding, points: np.ndarray, faces: np.ndarray) -> None:
    """Write landmarks as `placed_landmarks` reads them, to a micrometre."""
    corners = faces[landmarks.faces]
    vertices = np.take_along_axis(corners, landmarks.barycentrics.argmax(axis=1)[:, None], axis=1)[:, 0]
    places = np.round(1000.0 * landmarks.points(points.astype(np.float64), faces), 3) + 0.0
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("id,vertex,x,y,z\n")
        for landmark, vertex, place in zip(landmarks.ids, vertices, places, strict=True):
            file.write(f"{landmark},{vertex},{place[0]:.3f},{place[1]:.3f},{place[2]:.3f}\n")


def on_faces(
    places: np.ndarray, points: np.ndarray, faces: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The points of some faces that are nearest to places.

    Args:
        places: (N, 3).
        points: (V, 3) vertices.
        faces: (F, 3) integer vertex ids.
        chosen: (C,) which faces.

    Returns:
        (N,) face ids and (N, 3) barycentric coordinates.
    """
    nearest = closest_points(places, points, faces[chosen])
    return chosen[nearest.faces], nearest.barycentrics
