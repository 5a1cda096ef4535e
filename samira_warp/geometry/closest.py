"""The nearest points of a triangle mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree


class SurfacePoints(NamedTuple):
    """Points of a triangle mesh.

    Attributes:
        faces: (N,) int64 which face each lies on.
        barycentrics: (N, 3) float64 weights of that face's corners, none negative, each row summing to 1.
        distances: (N,) float64 how far they are from the points that they are nearest to.
    """

    faces: np.ndarray
    barycentrics: np.ndarray
    distances: np.ndarray


def closest_points(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> SurfacePoints:
    """The point of a mesh that is nearest to each of some points; of equally near faces the first.

    Args:
        points: (N, 3).
        vertices: (V, 3).
        faces: (F, 3) integer vertex ids, at least one face.
    """
    points, corners = np.asarray(points, np.float64), np.asarray(vertices, np.float64)[faces]
    middles = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middles[:, None], axis=2).max()
    tree = cKDTree(middles)
    # the nearest point is no farther than the nearest middle, so its face's middle is within that and a reach
    radii = tree.query(points)[0] + reach
    result = SurfacePoints(
        np.zeros(len(points), np.int64), np.zeros((len(points), 3)), np.full(len(points), np.inf)
    )
    for index, (point, near) in enumerate(
        zip(points, tree.query_ball_point(points, radii * (1 + 1e-12)), strict=True)
    ):
        candidates = np.sort(np.array(near))
        weights, distances = _closest_on_triangles(point, corners[candidates])
        best = distances.argmin()
        result.faces[index], result.barycentrics[index] = candidates[best], weights[best]
        result.distances[index] = distances[best]
    return result


def _closest_on_triangles(point: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) barycentric coordinates of the points of (T, 3, 3) triangles nearest to one, and (T,) distances.

    It is the foot of the perpendicular where that lies within the triangle, else the nearest of its edges'
    points; a triangle without area has edges alone.
    """
    choices = [_on_plane(point, corners)]
    for start in range(3):
        end = (start + 1) % 3
        edge = corners[:, end] - corners[:, start]
        length = np.maximum((edge**2).sum(axis=1), np.finfo(np.float64).tiny)
        share = np.clip(((point - corners[:, start]) * edge).sum(axis=1) / length, 0.0, 1.0)
        weights = np.zeros((len(corners), 3))
        weights[:, start], weights[:, end] = 1.0 - share, share
        choices.append(weights)
    stacked = np.stack(choices, axis=1)
    places = np.einsum("tck,tkx->tcx", stacked, corners)
    distances = np.linalg.norm(places - point, axis=2)
    distances[(stacked < 0.0).any(axis=2)] = np.inf
    rows, best = np.arange(len(corners)), distances.argmin(axis=1)
    return stacked[rows, best], distances[rows, best]


def _on_plane(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(T, 3) barycentric coordinates of the feet of the perpendiculars; negative where there is no area."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    normal = np.cross(u, v)
    doubled = (normal**2).sum(axis=1)
    flat = doubled < np.finfo(np.float64).tiny
    doubled = np.where(flat, 1.0, doubled)
    second = (np.cross(w, v) * normal).sum(axis=1) / doubled
    third = (np.cross(u, w) * normal).sum(axis=1) / doubled
    return np.where(flat[:, None], -1.0, np.stack([1.0 - second - third, second, third], axis=1))
