"""The built-in head in any pose, and what rays meet on it, in millimetres from midway between the eyes."""

import functools

import numpy as np
import torch

from samira_subject.anatomy.assembly import PARTS
from samira_subject.anatomy.mouth import LINE
from samira_subject.head import ORIGIN, build_head
from samira_warp.head import FLAME_JOINTS, Rig

MOUTH = (np.arange(-22.0, 22.1, 0.83), np.arange(LINE - 14.0, LINE + 14.0, 0.71))
FACE = (np.arange(-62.0, 62.0, 1.3), np.arange(-112.0, 62.0, 1.4))
"""Places, x and y in millimetres, between which no gap is as wide as what is looked for there."""


@functools.cache
def model():
    return Rig.build(build_head().template).to(dtype=torch.float64)


def anatomy():
    return build_head().anatomy


def pose(*, identity=None, jaw=0.0, eyes=(0.0,) * 6, **expressions):
    """(V, 3) float64 vertices."""
    rest = model().rest()
    for name, weight in expressions.items():
        rest.expression[build_head().template.expression_names.index(name)] = weight
    rest.rotations[FLAME_JOINTS.index("jaw"), 0] = jaw
    rest.rotations[FLAME_JOINTS.index("left_eye") :] = torch.tensor(eyes).view(2, 3)
    shape = (
        torch.zeros(model().n_shape, dtype=torch.float64)
        if identity is None
        else torch.as_tensor(identity, dtype=torch.float64)
    )
    return 1000.0 * model().pose(rest, shape).vertices.numpy() - ORIGIN


def expression(name):
    """(V, 3) millimetres."""
    template = build_head().template
    return 1000.0 * template.shapedirs[:, :, template.n_shape + template.expression_names.index(name)].astype(
        np.float64
    )


def people(count):
    """(count, 20) identities, those of seeds from 1 on."""
    return np.stack([build_head(seed).identity for seed in range(1, count + 1)])


def lip_edges():
    """(upper, lower) vertices where the lips meet, from the right corner to the left one."""
    a, faces = anatomy(), build_head().template.faces
    inside = a.is_part("mouth")
    joining = faces[inside[faces].any(axis=1) & ~inside[faces].all(axis=1)]
    edge = np.unique(joining[~inside[joining]])
    edge = edge[np.argsort(a.points[edge, 0], kind="stable")]
    return edge[a.turn[edge] > 0.1], edge[a.turn[edge] < -0.1]


def normals(vertices, faces):
    """(F, 3) twice the area outwards."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.cross(b - a, c - a)


def faces_seen(vertices, x, y, *, bearing=0.0):
    """(X, Y) face that rays through a grid of places meet first, -1 for none.

    The viewer is far away, as many degrees to the subject's left of the front as ``bearing`` says; ``x`` and
    ``y`` increase, to the viewer's right and up.
    """
    faces = build_head().template.faces
    angle = np.radians(bearing)
    across = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    points = vertices @ np.stack([across, [0.0, 1.0, 0.0], np.cross(across, [0.0, 1.0, 0.0])], axis=1)
    corners = points[faces]
    twice = normals(points, faces)[:, 2]
    low, high = corners.min(axis=1), corners.max(axis=1)
    left, right = np.searchsorted(x, low[:, 0]), np.searchsorted(x, high[:, 0], side="right")
    bottom, top = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1], side="right")
    counts = (right - left) * (top - bottom) * (np.abs(twice) > 1e-9)
    # every pair of a face and a place within its bounds
    face = np.repeat(np.arange(len(faces)), counts)
    number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column, row = left[face] + number // (top - bottom)[face], bottom[face] + number % (top - bottom)[face]
    a, b, c = np.moveaxis(corners[face], 1, 0)
    u, v, w = b - a, c - a, np.column_stack([x[column], y[row]]) - a[:, :2]
    s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice[face]
    t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice[face]
    met = np.flatnonzero((s >= 0) & (t >= 0) & (s + t <= 1))
    depth = (a[:, 2] + s * u[:, 2] + t * v[:, 2])[met]
    nearest_last = met[np.argsort(depth, kind="stable")]
    seen = np.full((len(x), len(y)), -1)
    seen[column[nearest_last], row[nearest_last]] = face[nearest_last]
    return seen


def share_facing(vertices, x, y, *, bearing=0.0):
    """Share of what a viewer sees of the head at a grid of places that turns its outside to them, and how
    many places that is."""
    seen = faces_seen(vertices, x, y, bearing=bearing)
    angle = np.radians(bearing)
    towards = normals(vertices, build_head().template.faces)[seen[seen >= 0]] @ [
        np.sin(angle),
        0.0,
        np.cos(angle),
    ]
    return (towards > 0).mean(), len(towards)


def parts_seen(vertices, x, y):
    """Names of the parts that a viewer far in front sees at a grid of places; None is among them where there
    is nothing."""
    seen = faces_seen(vertices, x, y)
    # a face that joins skin and the lining of the mouth has its outermost corners on the lips
    numbers = anatomy().part[build_head().template.faces].min(axis=1)[seen[seen >= 0]]
    return {PARTS[number] for number in np.unique(numbers)} | ({None} if (seen < 0).any() else set())
