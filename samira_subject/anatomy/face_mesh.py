"""Where the points of the face mesh that detectors find lie on the mean head."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.mouth import WITHIN
from samira_warp.head.landmarks import LandmarkEmbedding
from samira_warp.head.placed_landmarks import placed_landmarks

FILE = "face_mesh.csv"
"""As `tools/place_landmarks.py` placed them."""


def face_mesh(points: np.ndarray, faces: np.ndarray) -> LandmarkEmbedding:
    """All 478 landmarks on the mean head (V, 3), metres in the template's frame, and its faces (F, 3)."""
    return placed_landmarks(FILE, "samira_subject", points, faces)


def rims(a: Anatomy) -> dict[str, np.ndarray]:
    """Vertices along the edges of lids and lips, as `samira_warp.head.landmark_placement.RIMS` names them.

    A lid's edge is where the skin is; lips end where they meet.
    """
    found = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        edge = np.flatnonzero((a.lid == 0.0) & (sign * a.points[:, 0] > 0.0))
        edge = edge[np.argsort(np.abs(a.turn[edge]), kind="stable")]
        corners = edge[[0, -1]]
        for name, half in (("upper", 1.0), ("lower", -1.0)):
            found[f"{side}_{name}"] = edge[(half * a.turn[edge] > 0.0) | np.isin(edge, corners)]
    edge = _meeting(a)
    turn = a.turn[edge]
    for name, chosen in (("lip_upper", turn >= 0.0), ("lip_lower", turn <= 0.0)):
        found[name] = edge[chosen][np.argsort(a.points[edge[chosen], 0], kind="stable")]
    return found


def _meeting(a: Anatomy) -> np.ndarray:
    """Vertices where the lips meet: of those in one direction from the mouth's middle, the innermost."""
    lips = np.flatnonzero(a.is_part("skin") & (a.lip > WITHIN) & (a.lip <= 0.0))
    order = lips[np.argsort(a.lip[lips], kind="stable")]
    direction = np.column_stack([np.round(a.turn[order], 5), np.sign(a.points[order, 0])])
    return order[np.unique(direction, axis=0, return_index=True)[1]]
