import numpy as np
import pytest

from samira_warp.geometry.closest import closest_points

STEPS = 60
"""Steps along an edge of the brute force's grid."""


def grid():
    """Barycentric coordinates of a dense grid on a triangle, its edges and corners among them."""
    return (
        np.array([(i, j, STEPS - i - j) for i in range(STEPS + 1) for j in range(STEPS + 1 - i)], np.float64)
        / STEPS
    )


@pytest.fixture
def mesh():
    generator = np.random.default_rng(4)
    return generator.standard_normal((14, 3)), generator.permuted(np.tile(np.arange(14), (20, 1)), axis=1)[
        :, :3
    ]


def test_no_other_point_is_nearer(mesh):
    vertices, faces = mesh
    points = np.random.default_rng(5).standard_normal((60, 3)) * 1.5
    found = closest_points(points, vertices, faces)
    places = (found.barycentrics[:, :, None] * vertices[faces[found.faces]]).sum(axis=1)
    assert (found.barycentrics >= 0).all()
    assert np.abs(found.barycentrics.sum(axis=1) - 1.0).max() < 1e-12
    assert np.abs(np.linalg.norm(places - points, axis=1) - found.distances).max() < 1e-12
    dense = np.einsum("gk,fkx->fgx", grid(), vertices[faces]).reshape(-1, 3)
    brute = np.linalg.norm(dense[None] - points[:, None], axis=2).min(axis=1)
    # the grid misses the nearest point by at most a step along two edges, none longer than 2 x 4
    assert (found.distances <= brute + 1e-12).all()
    assert (brute - found.distances).max() < 2 * 8.0 / STEPS


def test_points_of_the_mesh_are_found_again(mesh):
    vertices, faces = mesh
    weights = np.random.default_rng(6).dirichlet(np.ones(3), len(faces))
    points = (weights[:, :, None] * vertices[faces]).sum(axis=1)
    found = closest_points(points, vertices, faces)
    assert found.distances.max() < 1e-12
    same = found.faces == np.arange(len(faces))
    assert same.any()
    assert np.abs(found.barycentrics - weights)[same].max() < 1e-9


def test_a_face_without_area_is_met_at_its_edges():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    found = closest_points(np.array([[2.0, 1, 0], [-1, 0, 0]]), vertices, np.array([[0, 1, 2], [1, 1, 1]]))
    assert found.distances == pytest.approx([1.0, 1.0])
    assert (found.barycentrics @ vertices[:, 0])[0] == pytest.approx(2.0)
