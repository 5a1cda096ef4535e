"""Smooth bases against closed forms on the sphere, and symmetries, on the built-in head."""

import dataclasses
import functools
import hashlib
import subprocess

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from warm_start import warm_python

from samira_subject.anatomy.assembly import mean_anatomy
from samira_subject.head import build_template
from samira_warp.head.smooth_basis import DENSITIES, smooth_basis
from samira_warp.support.errors import UserError

RADIUS = 0.1


def with_mesh(points, faces, **masks):
    """The built-in template with another mesh, of which nothing but vertices, faces and masks is used."""
    ids = {name: np.asarray(values, np.int32) for name, values in masks.items()}
    return dataclasses.replace(
        build_template(), v_template=points.astype(np.float32), faces=faces.astype(np.int32), masks=ids
    )


@functools.cache
def sphere(count=2000):
    """Points of a spiral, evenly spread, and the triangles of their hull."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
    ring = np.sqrt(1.0 - height**2)
    points = RADIUS * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    return points, ConvexHull(points).simplices


@functools.cache
def on_the_head():
    return smooth_basis(build_template(), 60)


def masses(points, faces, density):
    """(V,) a third of the faces about each vertex, times its density."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return density * np.bincount(faces.ravel(), np.repeat(areas / 3.0, 3), minlength=len(points))


def test_on_a_sphere_they_are_spherical_harmonics():
    """Eigenvalues l (l + 1) / r^2, 2 l + 1 of each; vectors of degree 1 are the coordinates."""
    points, faces = sphere()
    basis = smooth_basis(with_mesh(points, faces), 16)
    degrees = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
    wanted = degrees * (degrees + 1) / RADIUS**2
    # edges are h = sqrt(4 pi / 2000) r = 0.08 r; linear elements err by about l (l + 1) h^2 / 12
    assert np.abs(basis.eigenvalues[1:] / wanted[1:] - 1.0).max() < 12 * 0.08**2 / 12 * 2
    assert basis.eigenvalues[0] == 0.0
    coordinates = np.sqrt(3.0) * points / RADIUS
    within = basis.vectors[:, 1:4] @ np.linalg.lstsq(basis.vectors[:, 1:4], coordinates, rcond=None)[0]
    assert np.abs(within - coordinates).max() < 0.02


def test_orthogonal_with_a_mean_square_of_one_and_the_first_constant():
    template, basis = build_template(), on_the_head()
    assert (basis.vectors[:, 0] == 1.0).all()
    assert (np.diff(basis.eigenvalues) > 0.0).all()
    skin = mean_anatomy().is_part("skin", "mouth")
    faces = template.faces[skin[template.faces].all(axis=1)]
    density = np.ones(len(skin))
    for mask in ("face", "mouth"):
        density[template.masks[mask]] = DENSITIES[mask]
    mass = masses(template.v_template.astype(np.float64), faces, density)
    vectors = basis.vectors.astype(np.float64)
    product = (vectors * mass[:, None]).T @ vectors / mass.sum()
    # float32 vectors of up to some 5: products of 1e-7 x 25, and ARPACK's own error below that
    assert np.abs(product - np.eye(60)).max() < 1e-5


def test_a_symmetric_head_has_symmetric_and_antisymmetric_vectors():
    vectors = on_the_head().vectors.astype(np.float64)
    skin = mean_anatomy().is_part("skin", "mouth")
    mirrored = vectors[mean_anatomy().mirror]
    signs = np.sign((vectors * mirrored)[skin].sum(axis=0))
    # the two diagonals of a quad are mirrored as well: what is left is rounding, 1e-7 of 5, over gaps between
    # eigenvalues of a hundredth
    assert np.abs(mirrored - signs * vectors)[skin].max() < 1e-3
    assert (signs > 0).sum() > 20
    assert (signs < 0).sum() > 20


def test_they_change_little_along_an_edge():
    """The gradient's mean square is the eigenvalue: over an edge of 6 mm the 60th changes by 0.3 or so."""
    template, basis = build_template(), on_the_head()
    face = np.isin(template.faces, template.masks["face"]).all(axis=1)
    edges = template.faces[face][:, :2]
    lengths = np.linalg.norm(np.diff(template.v_template[edges], axis=1)[:, 0], axis=1)
    slopes = np.abs(np.diff(basis.vectors[edges], axis=1)[:, 0]) / lengths[:, None]
    # the face is four times as heavy: its waves have twice the frequency, sqrt(4 x eigenvalue), and the mean
    # square of a gradient along one direction is half of the whole; a wave may be several times as high here
    # as on average
    bound = 5.0 * np.sqrt(4.0 * basis.eigenvalues[1:] / 2.0)
    assert (np.sqrt((slopes[:, 1:] ** 2).mean(axis=0)) < bound).all()


def test_eyeballs_and_teeth_keep_their_form_and_ears_stay_on():
    template, basis, a = build_template(), on_the_head(), mean_anatomy()
    for part in ("left_eyeball", "right_eyeball", "teeth_upper", "teeth_lower"):
        assert np.ptp(basis.vectors[a.is_part(part)], axis=0).max() == 0.0
    skin = np.flatnonzero(a.is_part("skin"))
    for part in ("left_ear", "right_ear"):
        for vertex in np.flatnonzero(a.is_part(part)):
            gaps = np.linalg.norm(template.v_template[skin] - template.v_template[vertex], axis=1)
            if gaps.min() < 3e-3:
                near = skin[gaps.argmin()]
                change = np.abs(basis.vectors[vertex] - basis.vectors[near])
                assert (change < 5.0 * np.sqrt(4.0 * basis.eigenvalues.max()) * 3e-3).all()
    eye = basis.vectors[a.is_part("left_eyeball")][0]
    lids = basis.vectors[(a.lid == 0.0) & (a.points[:, 0] > 0.0)]
    assert (lids.min(axis=0) - 0.5 < eye).all()
    assert (eye < lids.max(axis=0) + 0.5).all()


def test_parts_that_end_in_the_same_places_are_sewn_up():
    """A sphere that is cut in two, the vertices along the cut doubled, has the vectors of the whole one."""
    points, faces = sphere()
    whole = smooth_basis(with_mesh(points, faces), 9)
    above = points[faces].mean(axis=1)[:, 2] > 0.02
    upper, lower = np.unique(faces[above]), np.unique(faces[~above])
    place = np.full((2, len(points)), -1)
    place[0, upper], place[1, lower] = np.arange(len(upper)), len(upper) + np.arange(len(lower))
    cut = np.concatenate([place[0][faces[above]], place[1][faces[~above]]])
    halves = smooth_basis(with_mesh(points[np.concatenate([upper, lower])], cut), 9)
    assert np.abs(halves.eigenvalues - whole.eigenvalues).max() < 1e-6 * whole.eigenvalues.max()
    # the order of vertices decides signs, and turns vectors of one eigenvalue about each other: spans count
    got = halves.vectors.astype(np.float64)
    wanted = whole.vectors[np.concatenate([upper, lower])].astype(np.float64)
    assert np.abs(got @ np.linalg.lstsq(got, wanted, rcond=None)[0] - wanted).max() < 1e-4


def test_a_part_apart_follows_and_counts_for_nothing():
    points, faces = sphere(400)
    near = points[:60] * 1.1
    other = ConvexHull(near).simplices + len(points)
    alone = smooth_basis(with_mesh(points, faces), 5)
    both = smooth_basis(with_mesh(np.concatenate([points, near]), np.concatenate([faces, other])), 5)
    assert np.array_equal(both.vectors[: len(points)], alone.vectors)
    # it lies a tenth farther out, over the points that it was made of: the nearest are those or beside them
    assert np.abs(both.vectors[len(points) :] - alone.vectors[:60]).max() < 0.2


def test_a_face_without_area_does_no_harm():
    points, faces = sphere(400)
    flat = np.array([[0, 1, 1], [5, 5, 5]])
    plain = smooth_basis(with_mesh(points, faces), 4)
    basis = smooth_basis(with_mesh(points, np.concatenate([faces, flat])), 4)
    assert np.abs(basis.eigenvalues - plain.eigenvalues).max() < 1e-6 * plain.eigenvalues.max()


@pytest.mark.parametrize("count", [0, 400])
def test_a_count_that_there_is_not(count):
    with pytest.raises(UserError, match=r"count: expected 1 to 399, fewer than the skin's vertices"):
        smooth_basis(with_mesh(*sphere(400)), count)


def test_the_same_bits_in_another_process():
    program = (
        "import hashlib; from samira_subject.head import build_template; "
        "from samira_warp.head.smooth_basis import smooth_basis; basis = smooth_basis(build_template(), 60); "
        "print(hashlib.sha256(basis.vectors.tobytes() + basis.eigenvalues.tobytes()).hexdigest())"
    )
    done = subprocess.run([*warm_python(), "-c", program], capture_output=True, text=True, check=True)
    basis = on_the_head()
    own = hashlib.sha256(basis.vectors.tobytes() + basis.eigenvalues.tobytes()).hexdigest()
    assert done.stdout.strip() == own
