"""How the skin's vertices are connected: half a head unrolled, its openings ringed, the rest triangulated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import Delaunay

from samira_subject.anatomy.eyes import lid_rings
from samira_subject.anatomy.landmarks import face_surface, seen_at
from samira_subject.anatomy.mouth import HALF_VERTICES, LINE, lip_rings
from samira_subject.anatomy.rings import Ring, strip
from samira_subject.anatomy.sections import descent_of_front, lowest_descent, section_surface

SCALE = 85.0
"""Millimetres on the unrolled head for a radian of azimuth: about the head's radius."""

FACE_SPACING, SKULL_SPACING, BACK_SPACING = 5.6, 10.0, 12.0
"""Millimetres between vertices on the face, above and below it, and behind: some 5,500 vertices in all."""

FAR = 99.0
"""Stands for a distance that does not matter."""


class HalfSkin(NamedTuple):
    """The skin on the subject's left, midline included, with what lines the mouth.

    Attributes:
        points: (N, 3) millimetres; x is exactly 0 on the midline.
        chart: (N, 2) azimuth and descent.
        triangles: (T, 3) vertex ids, counter-clockwise from outside.
        lid: (N,) millimetres from the lids' edge, negative behind it; FAR away from the eye.
        lip: (N,) millimetres from the lips' border, negative on the lips, -20 and less within the mouth; FAR
            away from the mouth.
        turn: (N,) radians about the opening, 0 at its outer corner, positive above; 0 away from openings.
        cavity: (N,) share of the way from the lips, 0, to the throat, 1.
    """

    points: np.ndarray
    chart: np.ndarray
    triangles: np.ndarray
    lid: np.ndarray
    lip: np.ndarray
    turn: np.ndarray
    cavity: np.ndarray


def half_skin() -> HalfSkin:
    """Lay out the vertices and connect them."""
    lids, lips = lid_rings(), lip_rings()
    lid_count = sum(len(ring.points) for ring in (*lids[0], *lids[1]))
    rings = [*lids[0], *lids[1], *lips[0], *lips[1]]
    outwards = np.concatenate([ring.outwards for ring in rings])
    is_lid = np.arange(len(outwards)) < lid_count
    free = _free_points(lids[1][-1], lips[1][-1])
    throat = np.array([[0.0, LINE, lips[0][0].points[0, 2] - 4.0]])
    crown = np.array([[0.0, 0.0]])
    chart = np.concatenate([*(ring.chart for ring in rings), free, lips[0][0].chart[:1], crown])
    points = np.concatenate(
        [*(ring.points for ring in rings), face_surface(*free.T), throat, face_surface(*crown.T)]
    )
    # what an iteration leaves off the midline would keep the halves apart
    chart[np.abs(chart[:, 0]) < 1e-4, 0] = 0.0
    points[np.abs(points[:, 0]) < 1e-3, 0] = 0.0
    ids = np.concatenate(
        [_last_ids(lids, 0), _last_ids(lips, lid_count), len(outwards) + np.arange(len(free))]
    )
    triangles = [
        _strips(lids, 0, closed=True),
        _strips(lips, lid_count, closed=False),
        _triangulate(chart, ids, (lids[1][-1], lips[1][-1])),
        _fan(len(points) - 2, lid_count + np.arange(HALF_VERTICES)),
        _fan(len(points) - 1, _top_row(chart, ids)),
    ]
    rest = len(points) - len(outwards)
    cavity = np.zeros(len(points))
    cavity[lid_count : lid_count + len(lips[0]) * HALF_VERTICES] = np.repeat(
        _depths(len(lips[0])), HALF_VERTICES
    )
    cavity[-2] = 1.0
    lip = np.concatenate([np.where(is_lid, FAR, outwards), np.full(rest, FAR)])
    lip[-2] = lip[lid_count] - 1.0
    return HalfSkin(
        points=points,
        chart=chart,
        triangles=np.concatenate(triangles),
        lid=np.concatenate([np.where(is_lid, outwards, FAR), np.full(rest, FAR)]),
        lip=lip,
        turn=np.concatenate([_turns(lids, closed=True), _turns(lips, closed=False), np.zeros(rest)]),
        cavity=cavity,
    )


def _depths(rings: int) -> np.ndarray:
    """Shares of the way to the throat, from the deepest ring out."""
    return (rings - np.arange(rings)) / (rings + 1.0)


def _fan(pole: int, rim: np.ndarray) -> np.ndarray:
    return np.column_stack([np.full(len(rim) - 1, pole), rim[:-1], rim[1:]])


def _top_row(chart: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Vertices nearest to the crown, by azimuth."""
    top = ids[chart[ids, 1] == chart[ids, 1].min()]
    return top[np.argsort(chart[top, 0])]


def _turns(rings: tuple[list[Ring], list[Ring]], *, closed: bool) -> np.ndarray:
    """Angles of an opening's vertices, ring after ring."""
    count = len(rings[1][0].points)
    if closed:
        turn = 2.0 * np.pi * np.arange(count) / count
        turn = np.where(turn > np.pi, turn - 2.0 * np.pi, turn)
    else:
        turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, count)
    return np.tile(turn, len(rings[0]) + len(rings[1]))


def _last_ids(rings: tuple[list[Ring], list[Ring]], start: int) -> np.ndarray:
    count = len(rings[1][-1].points)
    return start + count * (len(rings[0]) + len(rings[1]) - 1) + np.arange(count)


def _strips(rings: tuple[list[Ring], list[Ring]], start: int, *, closed: bool) -> np.ndarray:
    everything = [*rings[0], *rings[1]]
    count = len(everything[0].points)
    return np.concatenate(
        [
            strip(count, start + count * k, start + count * (k + 1), closed=closed)
            for k in range(len(everything) - 1)
        ]
    )


def _free_points(lid: Ring, lip: Ring) -> np.ndarray:
    """(N, 2) vertices away from openings: rows of even spacing, finer on the face and finest on the nose."""
    nose = _nose_points()
    rows, descent = [], 11.0
    index = 0
    while descent < lowest_descent() - 3.0:
        rows.append(_row(descent, index))
        descent += _row_spacing(descent)
        index += 1
    rows.append(_row(lowest_descent(), index))
    grid = np.concatenate(rows)
    grid = grid[_distance(grid, nose) > 0.65 * FACE_SPACING]
    everything = np.concatenate([nose, grid])
    keep = ~_within(everything, lid, 0.43 * FACE_SPACING) & ~_within(everything, lip, 0.43 * FACE_SPACING)
    return everything[keep]


def _nose_points() -> np.ndarray:
    """A honeycomb about the nose in front view."""
    points = []
    for index, y in enumerate(np.arange(-51.0, -4.0, 2.6)):
        half_width = 7.0 + 16.0 * min(max((-y - 4.0) / 26.0, 0.0), 1.0)
        xs = np.arange(0.0 if index % 2 == 0 else 1.5, half_width, 3.0)
        if index % 2:
            xs = np.concatenate([[0.0], xs])
        points.append(np.column_stack([xs, np.full(len(xs), y)]))
    flat = np.concatenate(points)
    azimuth, descent = seen_at(*flat.T)
    azimuth[flat[:, 0] == 0.0] = 0.0
    return np.column_stack([azimuth, descent])


def _row_spacing(descent: float) -> float:
    face = descent_of_front(np.array([60.0, -112.0]))
    return FACE_SPACING if face[0] < descent < face[1] else SKULL_SPACING


def _row(descent: float, index: int) -> np.ndarray:
    """Vertices of one level from the midline in front to the one behind."""
    dense = np.linspace(0.0, np.pi, 400)
    line = section_surface(dense, np.full(400, descent))
    lengths = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1)])
    front = _row_spacing(descent)
    spacing = front + (BACK_SPACING - front) * (
        1.0 - np.asarray(np.clip((np.cos(dense) - 0.1) / 0.6, 0.0, 1.0))
    )
    steps = np.cumsum(lengths / spacing)
    count = max(round(steps[-1]), 4)
    wanted = (
        np.arange(count + 1) / count
        if index % 2 == 0
        else np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]])
    )
    return np.column_stack([np.interp(wanted * steps[-1], steps, dense), np.full(len(wanted), descent)])


def _flat(chart: np.ndarray) -> np.ndarray:
    """The unrolled head in millimetres, true to angles where the head narrows at the crown."""
    dense = np.linspace(1.0, lowest_descent(), 2000)
    radius = np.maximum(section_surface(np.full(2000, 0.5 * np.pi), dense)[:, 0], 4.0)
    conformal = np.concatenate([[0.0], np.cumsum(np.diff(dense) * SCALE / radius[1:])])
    return np.column_stack([SCALE * chart[:, 0], np.interp(chart[:, 1], dense, conformal)])


def _distance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    scale = np.array([SCALE, 1.0])
    return np.linalg.norm((points[:, None] - others[None]) * scale, axis=-1).min(axis=1)


def _within(points: np.ndarray, ring: Ring, margin: float) -> np.ndarray:
    """Whether points of the chart lie within a ring, or nearer to it than ``margin`` millimetres."""
    return _inside(points, ring) | (_distance(points, ring.chart) < margin)


def _inside(points: np.ndarray, ring: Ring) -> np.ndarray:
    corners = ring.chart
    if abs(corners[0, 0]) < 1e-4:
        corners = np.concatenate([corners, corners[::-1] * (-1.0, 1.0)])
    return _winding(points, corners)


def _winding(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b = corners, np.roll(corners, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    height = np.where(np.abs(b[:, 1] - a[:, 1]) < 1e-12, 1.0, b[:, 1] - a[:, 1])
    left = x < a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / height
    return (crosses & left).sum(axis=1) % 2 == 1


def _triangulate(chart: np.ndarray, ids: np.ndarray, holes: tuple[Ring, ...]) -> np.ndarray:
    """Delaunay triangles of some vertices, but for those that lie within a ring."""
    flat = _flat(chart)
    triangles = ids[Delaunay(flat[ids]).simplices]
    middles = chart[triangles].mean(axis=1)
    for hole in holes:
        triangles = triangles[~_inside(middles, hole)]
        middles = chart[triangles].mean(axis=1)
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = triangles[np.abs(area) > 1e-6]
    area = area[np.abs(area) > 1e-6]
    # descent grows downwards: counter-clockwise from outside is a negative area here
    return np.where((area > 0.0)[:, None], triangles[:, [0, 2, 1]], triangles)
