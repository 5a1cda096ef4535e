"""Smooth offsets of any head: the lowest vibrations of its skin.

Eigenvectors of the Laplacian are the smoothest functions on a surface (Vallet and Levy, Spectral Geometry
Processing with Manifold Harmonics, 2008), here by the cotangent formula (Pinkall and Polthier, 1993).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh
from threadpoolctl import threadpool_limits

from samira_warp.geometry.closest import closest_points
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError

DENSITIES = {"face": 4.0, "mouth": 0.02}
"""How many times as heavy a square metre of a mask is as one of scalp and neck. Waves are half as long on the
face, so that few vectors say much about it; what lines the mouth has none of its own and follows the lips."""

RIGID_MASKS = ("left_eyeball", "right_eyeball", "teeth", "teeth_upper", "teeth_lower")
"""Parts that keep their form: each moves as a whole, with the skin about it."""

WELD = 1e-6
"""Metres below which two vertices on the borders of parts are one: parts that are cut apart end in the same
places up to rounding."""

MOST_COSECANT = 1e3
"""Limit of an angle's cotangent: beyond it, at some 0.06 degrees, a face is a line and cotangents noise."""

SHIFT = 1e-3
"""What is added to the eigenvalues while they are looked for, as a share of the lowest that Weyl's law
gives the surface: without it the matrix that is factored would be singular."""

_SEED = 2017
"""Of the start vector, and of the direction that decides the signs."""


class SmoothBasis(NamedTuple):
    """Smooth functions on a head's vertices, the smoothest first.

    Attributes:
        vectors: (V, K) float32. Over the skin they are orthogonal and their mean square is 1, by area under
            `DENSITIES`; the first is 1 everywhere. Times coefficients (K, 3) in metres they are offsets, each
            coefficient the root mean square of what it adds.
        eigenvalues: (K,) float64 per square metre, from 0 up: the mean of a vector's squared gradient, by the
            same weights. The sum of eigenvalue times squared coefficient is how much an offset stretches,
            the sum of squared eigenvalue times squared coefficient how much it bends.
    """

    vectors: np.ndarray
    eigenvalues: np.ndarray


def smooth_basis(template: HeadTemplate, count: int) -> SmoothBasis:
    """The smoothest functions on a head; the same bits in every run on a machine.

    They live on the largest connected part, which is the skin, borders that coincide being sewn up. Other
    parts follow it: eyeballs and teeth by what the skin nearest to them does on average, ears and all else
    vertex by vertex.

    Args:
        template: The head.
        count: K, how many, from 1 to fewer than the skin has vertices.

    Raises:
        UserError: There are not as many.
    """
    points = template.v_template.astype(np.float64)
    merged = _welded(points, template.faces)
    faces = merged[template.faces]
    part = _parts(faces, len(points))[merged]
    skin = np.bincount(part).argmax()
    skin_faces = faces[part[faces[:, 0]] == skin]
    used, local = np.unique(skin_faces, return_inverse=True)
    if not 1 <= count < len(used):
        raise UserError(
            "count", expected=f"1 to {len(used) - 1}, fewer than the skin's vertices", found=count
        )
    heavy = np.ones(len(points))
    for mask, density in DENSITIES.items():
        heavy[template.masks.get(mask, np.arange(0))] = density
    stiffness, mass = _operators(points[used], local.reshape(-1, 3), heavy[merged][used])
    eigenvalues, modes = _lowest(stiffness, mass, count)
    vectors = np.zeros((len(points), count))
    vectors[used] = modes
    vectors = vectors[merged]
    for other in np.setdiff1d(np.unique(part), [skin]):
        members = np.flatnonzero(part == other)
        vectors[members] = _following(template, members, skin_faces, vectors)
    return SmoothBasis(vectors.astype(np.float32), eigenvalues)


def _welded(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) the vertex that stands for each: the first of those on borders at the same place, else itself."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, uses = np.unique(edges, axis=0, return_counts=True)
    border = np.unique(edges[uses == 1])
    _, first, place = np.unique(
        np.round(points[border] / WELD), axis=0, return_index=True, return_inverse=True
    )
    merged = np.arange(len(points))
    merged[border] = border[first][place.ravel()]
    return merged


def _parts(faces: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) number of the connected part of each vertex."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    graph = csr_array((np.ones(len(start), bool), (start, end)), shape=(vertices, vertices))
    return connected_components(graph, directed=False)[1]


def _operators(points: np.ndarray, faces: np.ndarray, heavy: np.ndarray) -> tuple[csc_array, np.ndarray]:
    """Stiffness (N, N) of the cotangent Laplacian, and lumped masses (N,), square metres."""
    count = len(points)
    stiffness = csc_array((count, count))
    areas = np.zeros(count)
    for corner in range(3):
        apex, start, end = (faces[:, (corner + step) % 3] for step in range(3))
        one, other = points[start] - points[apex], points[end] - points[apex]
        doubled = np.linalg.norm(np.cross(one, other), axis=1)
        dot = (one * other).sum(axis=1)
        cotangent = np.clip(dot / np.maximum(doubled, 1e-300), -MOST_COSECANT, MOST_COSECANT)
        stiffness = stiffness + csc_array((0.5 * cotangent, (start, end)), shape=(count, count))
        areas += np.bincount(apex, doubled / 6.0, minlength=count)
    stiffness = -(stiffness + stiffness.T)
    stiffness = (stiffness - diags_array(np.asarray(stiffness.sum(axis=1)).ravel())).tocsc()
    # a vertex of faces without area has some mass all the same
    return stiffness, heavy * np.maximum(areas, 1e-6 * areas.mean())


def _lowest(stiffness: csc_array, mass: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(K,) lowest eigenvalues, rising, and (N, K) vectors of mean square 1 by the masses."""
    start = np.random.default_rng(_SEED).standard_normal(len(mass))
    shift = SHIFT * 4.0 * np.pi / mass.sum()
    with threadpool_limits(limits=1, user_api="blas"):  # sums of more threads end in other bits
        values, vectors = eigsh(
            stiffness, k=count, M=diags_array(mass).tocsc(), sigma=-shift, which="LM", v0=start
        )
    order = np.argsort(values, kind="stable")
    values, vectors = np.maximum(values[order], 0.0), vectors[:, order] * np.sqrt(mass.sum())
    vectors *= np.where((start * mass) @ vectors < 0.0, -1.0, 1.0)
    values[0], vectors[:, 0] = 0.0, 1.0
    return values, vectors


def _following(
    template: HeadTemplate, members: np.ndarray, skin_faces: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """(M, K) values at the vertices of a part that is not skin, from those at the skin's."""
    near = closest_points(template.v_template[members], template.v_template, skin_faces)
    values = np.einsum("mk,mkc->mc", near.barycentrics, vectors[skin_faces[near.faces]])
    rigid = np.concatenate([template.masks.get(name, np.arange(0)) for name in RIGID_MASKS])
    if np.isin(members, rigid).mean() > 0.5:
        closeness = 1.0 / np.maximum(near.distances, np.median(near.distances))
        return np.broadcast_to(np.average(values, axis=0, weights=closeness), values.shape)
    return values
