"""Teeth for FLAME, whose mouth is empty.

They are the vertices that VHAP and GaussianAvatars append, so that their static offsets fit.
"""

from __future__ import annotations

import numpy as np

from samira_warp.head.joints import FLAME_JOINTS

RING = 15
"""Vertices of each outer lip ring, from the head's left corner of the mouth to its right one."""

UPPER_LIP = (1713, 1715, 1716, 1735, 1696, 1694, 1657, 3543, 2774, 2811, 2813, 2850, 2833, 2832, 2830)
"""FLAME's outer ring of the upper lip."""

LOWER_LIP = (1576, 1577, 1773, 1774, 1795, 1802, 1865, 3503, 2948, 2905, 2898, 2881, 2880, 2713, 2712)
"""FLAME's outer ring of the lower lip."""

TEETH_VERTICES = 8 * RING
"""Four rows of each jaw."""

TEETH_FACES = 6 * 2 * (RING - 1)
"""Three strips of each jaw, two triangles a quad."""

(
    UPPER_ROOT,
    LOWER_ROOT,
    UPPER_EDGE,
    LOWER_EDGE,
    UPPER_ROOT_BACK,
    UPPER_EDGE_BACK,
    LOWER_ROOT_BACK,
    LOWER_EDGE_BACK,
) = range(8)
"""The rows, in the order in which their vertices follow FLAME's."""

_ROWS_IN_UV = (
    UPPER_ROOT,
    UPPER_EDGE,
    UPPER_EDGE_BACK,
    UPPER_ROOT_BACK,
    LOWER_ROOT_BACK,
    LOWER_EDGE_BACK,
    LOWER_EDGE,
    LOWER_ROOT,
)
_FREE_U = (0.62, 0.38)
_FREE_V = (1 - 0.0083, 1 - 0.0425)
"""A strip above the head that FLAME's UV layout leaves free. VHAP lets rows overlap in it; here each row has
its own height, so that a texel means one place."""

_BEHIND, _HALF_GAP, _HEIGHT, _LOWER_BEHIND, _THICKNESS = 1.5, 0.1, 2.0, 0.4, 1.0
"""Lengths in mean distances between the lip rings: how far the teeth are behind the lips, how far an edge is
from the middle, how long a tooth is, how much further back the lower ones are, and how thick they are."""


def add_teeth(arrays: dict[str, np.ndarray], *, n_shape: int) -> dict[str, np.ndarray]:
    """FLAME's arrays (`read_template`'s keys) with 120 vertices and 168 faces appended.

    Their UVs and masks come with them. Teeth take the mean of the lips' identity shapes; they have no
    expression and no pose correctives, the upper ones move with the neck joint and the lower ones with the
    jaw.
    """
    vertices = arrays["v_template"]
    upper, lower = np.array(UPPER_LIP), np.array(LOWER_LIP)
    shapes = np.zeros((TEETH_VERTICES, *arrays["shapedirs"].shape[1:]))
    shapes[:, :, :n_shape] = np.tile(
        (arrays["shapedirs"][upper, :, :n_shape] + arrays["shapedirs"][lower, :, :n_shape]) / 2, (8, 1, 1)
    )
    in_upper_jaw = np.isin(
        np.arange(TEETH_VERTICES) // RING, (UPPER_ROOT, UPPER_EDGE, UPPER_ROOT_BACK, UPPER_EDGE_BACK)
    )
    weights = np.zeros((TEETH_VERTICES, arrays["weights"].shape[1]))
    neck, jaw = FLAME_JOINTS.index("neck"), FLAME_JOINTS.index("jaw")
    weights[np.arange(TEETH_VERTICES), np.where(in_upper_jaw, neck, jaw)] = 1.0
    faces = teeth_faces()
    ids = len(vertices) + np.arange(TEETH_VERTICES)
    return {
        **arrays,
        "v_template": np.concatenate([vertices, _rows(vertices[upper], vertices[lower])]),
        "shapedirs": np.concatenate([arrays["shapedirs"], shapes]),
        "posedirs": np.concatenate(
            [arrays["posedirs"], np.zeros((TEETH_VERTICES, *arrays["posedirs"].shape[1:]))]
        ),
        "J_regressor": np.concatenate(
            [arrays["J_regressor"], np.zeros((len(arrays["J_regressor"]), TEETH_VERTICES))], axis=1
        ),
        "weights": np.concatenate([arrays["weights"], weights]),
        "f": np.concatenate([arrays["f"], faces + len(vertices)]),
        "vt": np.concatenate([arrays["vt"], _uvs()]),
        "ft": np.concatenate([arrays["ft"], faces + len(arrays["vt"])]),
        "mask_teeth_upper": ids[in_upper_jaw],
        "mask_teeth_lower": ids[~in_upper_jaw],
    }


def teeth_faces() -> np.ndarray:
    """(168, 3) triangles of the teeth's own vertices, outward: each jaw's front, back and edge."""
    strips = (
        (UPPER_EDGE, UPPER_ROOT),
        (UPPER_ROOT_BACK, UPPER_EDGE_BACK),
        (UPPER_EDGE_BACK, UPPER_EDGE),
        (LOWER_ROOT, LOWER_EDGE),
        (LOWER_EDGE_BACK, LOWER_ROOT_BACK),
        (LOWER_EDGE, LOWER_EDGE_BACK),
    )
    faces = []
    for first, second in strips:
        for column in range(RING - 1):
            a, b = first * RING + column, second * RING + column
            # diagonals mirror at the middle, as the head does
            faces += (
                [(a, b, a + 1), (b, b + 1, a + 1)]
                if column < RING // 2
                else [(a, b, b + 1), (a, b + 1, a + 1)]
            )
    return np.array(faces)


def _rows(upper_lip: np.ndarray, lower_lip: np.ndarray) -> np.ndarray:
    """(120, 3) vertices, built on the middle between the (15, 3) lip rings, flattened in y."""
    unit = np.linalg.norm(upper_lip - lower_lip, axis=1).mean()
    middle = (upper_lip + lower_lip) / 2
    middle[:, 1] = middle[:, 1].mean()
    middle[:, 2] -= _BEHIND * unit
    up, back = np.array([0.0, unit, 0.0]), np.array([0.0, 0.0, -unit])
    rows: dict[int, np.ndarray] = {
        UPPER_EDGE: middle + _HALF_GAP * up,
        LOWER_EDGE: middle - _HALF_GAP * up + _LOWER_BEHIND * back,
    }
    rows[UPPER_ROOT] = rows[UPPER_EDGE] + _HEIGHT * up
    rows[LOWER_ROOT] = rows[LOWER_EDGE] - _HEIGHT * up
    for front, behind in (
        (UPPER_ROOT, UPPER_ROOT_BACK),
        (UPPER_EDGE, UPPER_EDGE_BACK),
        (LOWER_ROOT, LOWER_ROOT_BACK),
        (LOWER_EDGE, LOWER_EDGE_BACK),
    ):
        rows[behind] = rows[front] + _THICKNESS * back
    return np.concatenate([rows[row] for row in range(8)])


def _uvs() -> np.ndarray:
    """(120, 2) UV coordinates, a row of the teeth a height.

    The strip's middle is left empty between the jaws.
    """
    heights = np.empty(8)
    heights[list(_ROWS_IN_UV)] = np.linspace(*_FREE_V, 9)[[0, 1, 2, 3, 5, 6, 7, 8]]
    u = np.linspace(*_FREE_U, RING)
    return np.stack([np.tile(u, 8), np.repeat(heights, RING)], axis=1)
