"""Wavefront files: vertices, polygons and UV coordinates, in the file's own order.

General mesh libraries reorder or split vertices where UV charts meet; head models are known by the numbers
that their files give the vertices.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from samira_warp.support.errors import UserError


class WavefrontMesh(NamedTuple):
    """What a file has, its polygons cut into triangles that fan out from their first corner.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int64 vertex ids.
        uvs: (T, 2) float64 UV coordinates, u to the right and v up.
        uv_faces: (F, 3) int64 ids of the corners' UV coordinates, -1 for a corner that has none.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    uv_faces: np.ndarray


def read_vertices(path: Path) -> np.ndarray:
    """(V, 3) float64 vertices of a file, nothing else of which is looked at.

    Raises:
        UserError: The file cannot be read, or a vertex is not three finite numbers.
    """
    words: list[bytes] = []
    lines = [line for line in _bytes_of(path).splitlines() if line.startswith(b"v ")]
    for line in lines:
        words += line.split(maxsplit=4)[1:4]
    try:
        vertices = np.array(words, np.float64).reshape(len(lines), 3)
    except ValueError as fault:
        raise UserError(path, expected="three numbers after each v", found=fault) from fault
    if not np.isfinite(vertices).all():
        raise UserError(path, expected="finite numbers after each v", found="NaN or infinity")
    return vertices


def read_mesh(path: Path) -> WavefrontMesh:
    """A file's polygons, with their UV coordinates.

    Raises:
        UserError: The file cannot be read or has no polygons, a line is broken, or an id is out of range.
    """
    vertices = read_vertices(path)
    uvs: list[list[float]] = []
    corners: list[tuple[list[int], list[int], list[int]]] = []
    for number, line in enumerate(_bytes_of(path).decode("utf-8", errors="replace").splitlines(), start=1):
        kind, *words = line.split() or [""]
        try:
            if kind == "vt":
                u, v = words[:2]
                uvs.append([float(u), float(v)])
            elif kind == "f":
                polygon = [_corner(word, len(vertices), len(uvs)) for word in words]
                corners += [(polygon[0], polygon[at], polygon[at + 1]) for at in range(1, len(polygon) - 1)]
        except ValueError as fault:
            place = f"{path}: line {number}"
            raise UserError(place, expected=f"numbers after {kind}", found=repr(line[:80])) from fault
    if not corners:
        raise UserError(path, expected="polygons (f)", found="none")
    faces, uv_faces = np.moveaxis(np.array(corners), 2, 0)
    for ids, what, count in ((faces, "vertices", len(vertices)), (uv_faces, "UV coordinates", len(uvs))):
        if ids.max() >= count or ids.min() < (0 if what == "vertices" else -1):
            found = f"{ids.min() + 1} to {ids.max() + 1}"
            raise UserError(path, expected=f"ids of its {count} {what} after each f", found=found)
    return WavefrontMesh(vertices, faces, np.array(uvs).reshape(-1, 2), uv_faces)


def _corner(word: str, vertices: int, uvs: int) -> list[int]:
    """Ids of a corner's vertex and UV coordinates, -1 for none; negative numbers count back from here."""
    vertex, uv = (*word.split("/")[:2], "")[:2]
    ids = [int(vertex), int(uv) if uv else 0]
    return [
        number - 1 if number >= 0 else count + number
        for number, count in zip(ids, (vertices, uvs), strict=True)
    ]


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as fault:
        raise UserError(path, expected="a Wavefront file", found=fault.strerror or fault) from fault
