"""Which vertices of ICT-FaceKit's mesh are what: parts by its README's numbers, regions by where they lie."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from samira_warp.head.template import HeadTemplate

VERTICES = 26719
"""Of the whole mesh."""

PARTS = {
    "face": (0, 9409),
    "head": (9409, 11248),
    "mouth_socket": (11248, 13294),
    "left_socket": (13294, 13678),
    "right_socket": (13678, 14062),
    "gums": (14062, 17039),
    "teeth_upper": (17039, 19247),
    "teeth_lower": (19247, 21451),
    "left_eyeball": (21451, 22221),
    "right_eyeball": (23021, 23791),
}
"""First vertex and the one after the last, of the parts that are kept; eyeballs without what lies within."""

KEPT = np.concatenate([np.arange(*ends) for ends in PARTS.values()])
"""(V,) numbers of the vertices that are kept, in rising order."""

OUTER_LIPS = (5708, 5695, 2081, 0, 4275, 6200, 6213, 6346, 6461, 5518, 5957, 5841)
"""Where the lips meet the skin, round the mouth: 48 to 59 of the 68 landmarks that the README lists."""

RIM_POINTS = {
    "right_upper": (1507, 1542, 1537, 1528),
    "right_lower": (1507, 1511, 1518, 1528),
    "left_upper": (3721, 3756, 3751, 3742),
    "left_lower": (3721, 3725, 3732, 3742),
    "lip_upper": (5702, 5711, 5533, 6216, 6207),
    "lip_lower": (5702, 5966, 5517, 6470, 6207),
}
"""Points along lids' edges, from outer corners to inner ones, and along where the lips meet, from the
subject's right to their left: of the 68 landmarks 36 to 47 and 60 to 67."""

HAIRLINE = (
    (10.6, 9.6),
    (8.5, 9.7),
    (7.0, 9.0),
    (5.2, 7.4),
    (4.2, 5.6),
    (3.6, 2.2),
    (0.0, 3.5),
    (-3.4, -6.0),
    (-9.4, -6.5),
)
"""Depth and height of the hair's edge, in the file's unit: forehead, temples, before the ears, nape."""

JAWLINE = ((-9.4, -6.5), (1.5, -6.5), (5.0, -6.6), (7.5, -7.6), (10.4, -8.2))
"""Depth and height of the edge between head and neck."""


def regions_of(neutral: np.ndarray) -> dict[str, np.ndarray]:
    """Vertex numbers of each region on the neutral mesh (26719, 3) in the file's unit; they may overlap.

    The names are FLAME's, as the built-in head has them.
    """
    x, y, z = neutral.T
    across = np.abs(x)
    face, head = _in_part("face"), _in_part("head")
    skin = face | head
    ear = face & (across > 6.7) & (z < 2.6) & (z > -1.2) & (y > -2.0) & (y < 4.8)
    neck = skin & (y < _edge(JAWLINE, z)) & ~ear
    hair = skin & (y > _edge(HAIRLINE, z)) & ~ear & ~neck
    front = face & ~ear & ~neck & ~hair
    eye = face & (z > 7.2) & (((across - 3.15) / 2.3) ** 2 + ((y - 3.45) / 1.9) ** 2 < 1.0)
    lips = face & (z > 9.0) & _within(neutral[:, :2], neutral[list(OUTER_LIPS), :2])
    width = np.interp(y, (-1.7, -0.5, 0.8, 3.5), (1.7, 2.1, 1.6, 0.8))
    named = {
        "face": front | lips,
        "neck": neck,
        "scalp": hair,
        "boundary": head & (y < -16.8),
        "forehead": front & (y > np.interp(across, (1.2, 3.8, 5.8, 7.4), (6.4, 6.8, 5.9, 4.2))),
        "nose": front & (z > 9.6) & (across < width) & (y > -1.6) & (y < 3.4) & ~eye,
        "lips": lips,
        "left_eye_region": (eye & (x > 0.0)) | _in_part("left_socket"),
        "right_eye_region": (eye & (x < 0.0)) | _in_part("right_socket"),
        "left_ear": ear & (x > 0.0),
        "right_ear": ear & (x < 0.0),
        "mouth": _in_part("mouth_socket") | _in_part("gums"),
        **{name: _in_part(name) for name in ("left_eyeball", "right_eyeball", "teeth_upper", "teeth_lower")},
    }
    return {name: np.flatnonzero(chosen) for name, chosen in named.items()}


def _in_part(name: str) -> np.ndarray:
    """(26719,) bool."""
    members = np.zeros(VERTICES, dtype=bool)
    members[slice(*PARTS[name])] = True
    return members


def _edge(line: tuple[tuple[float, float], ...], depth: np.ndarray) -> np.ndarray:
    """Heights of a line of (depth, height) at some depths."""
    depths, heights = np.array(sorted(line)).T
    return np.interp(depth, depths, heights)


def _within(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """(N,) bool: which of (N, 2) points a closed polygon (P, 2) goes round."""
    inside = np.zeros(len(points), dtype=bool)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if start[1] == end[1]:
            continue
        crosses = (start[1] > points[:, 1]) != (end[1] > points[:, 1])
        at = start[0] + (points[:, 1] - start[1]) * (end[0] - start[0]) / (end[1] - start[1])
        inside ^= crosses & (points[:, 0] < at)
    return inside


def ict_rims(template: HeadTemplate) -> dict[str, np.ndarray]:
    """Vertices along edges of lids and lips, of what is kept: the shortest ways through `RIM_POINTS`."""
    starts = np.concatenate([template.faces, np.roll(template.faces, -1, axis=1)]).ravel()
    ends = np.concatenate([np.roll(template.faces, -1, axis=1), template.faces]).ravel()
    lengths = np.linalg.norm(template.v_template[starts] - template.v_template[ends], axis=1)
    count = len(template.v_template)
    # entries of one edge add up: one within the mesh has two faces and counts twice, as all do on these ways
    graph = csr_array((lengths, (starts, ends)), shape=(count, count))
    rims = {}
    for name, points in RIM_POINTS.items():
        numbers = np.searchsorted(KEPT, points)
        way = [int(numbers[0])]
        for start, end in pairwise(numbers):
            before = dijkstra(graph, indices=start, return_predecessors=True)[1]
            step, back = [int(end)], int(end)
            while back != start:
                back = int(before[back])
                step.append(back)
            way += step[::-1][1:]
        rims[name] = np.array(way)
    return rims
