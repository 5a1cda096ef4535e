"""Cameras, rotations and meshes in plain torch; nothing in here knows what a face is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.geometry.mesh import face_areas, vertex_normals
    from samira_warp.geometry.rotation import axis_angle_to_matrix

__all__ = [
    "axis_angle_to_matrix",
    "face_areas",
    "vertex_normals",
]

__getattr__ = lazily(
    __name__,
    {
        "axis_angle_to_matrix": "rotation",
        "face_areas": "mesh",
        "vertex_normals": "mesh",
    },
)
