"""The mesh of `samira_warp.kernels.rays.ray_mesh` without a tree: its triangles."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class RayMesh(NamedTuple):
    """Triangles that rays are cast at.

    Attributes:
        vertices: (V, 3) of any float dtype.
        faces: (F, 3) integer vertex ids.
    """

    vertices: Tensor
    faces: Tensor
