"""Loop's subdivision, and lids kept off eyeballs."""

import numpy as np
import pytest
import torch
from subjects import parameters, small_template

from samira_subject.eyelids import CLEARANCE, EYEBALLS, Eyelids
from samira_subject.subdivision import LoopSubdivision, split_corners
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import Rig

OCTAHEDRON = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
)
CORNERS = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def grid(size=5):
    """A flat square of triangles, each inner vertex with six neighbours."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    corner = (y * size + x)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + size + 1], 1),
            np.stack([corner, corner + size + 1, corner + size], 1),
        ]
    )
    return torch.tensor(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), dtype=torch.float32), faces


def refined(vertices, faces):
    subdivision = LoopSubdivision.build(faces, vertices=len(vertices))
    return subdivision.refine(vertices), subdivision.faces


def test_a_closed_mesh_becomes_rounder_and_stays_closed():
    vertices, faces = refined(CORNERS, OCTAHEDRON)
    assert (len(vertices), len(faces)) == (6 + 12, 32)
    # valence 4: 1 - 4 * 3 / 32 of a corner, and neighbours that cancel
    assert vertices[:6].norm(dim=1) == pytest.approx(1 - 4 * 3 / 32)
    # 3 / 8 of both ends, 1 / 8 of corners that cancel
    assert vertices[6:].norm(dim=1) == pytest.approx(3 / 8 * np.sqrt(2))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))
    a, b, c = vertices[faces.long()].unbind(dim=1)
    assert ((torch.linalg.cross(b - a, c - a) * (a + b + c)).sum(dim=1) > 0).all()


def test_flat_things_stay_flat_and_borders_straight():
    vertices, faces = grid()
    fine, fine_faces = refined(vertices, faces)
    assert not fine[:, 2].any()
    assert fine[:, :2].min() == pytest.approx(0.0)
    border = [1, 2, 3]
    assert torch.allclose(fine[border], vertices[border])
    inner = [6, 7, 8, 11, 12, 13, 16, 17, 18]
    assert torch.allclose(fine[inner], vertices[inner], atol=1e-6)
    assert len(fine_faces) == 4 * len(faces)


def test_it_commutes_with_affine_maps(generator):
    turn, shift = torch.randn(3, 3, generator=generator), torch.randn(3, generator=generator)
    template = small_template()
    vertices = torch.from_numpy(template.v_template)
    subdivision = LoopSubdivision.build(template.faces, vertices=len(vertices))
    moved = subdivision.refine(vertices @ turn + shift)
    assert torch.allclose(moved, subdivision.refine(vertices) @ turn + shift, atol=1e-5)
    assert np.asarray(subdivision.weights.sum(axis=1)) == pytest.approx(1.0, abs=1e-6)


def test_parts_do_not_see_each_other():
    together = LoopSubdivision.build(np.concatenate([OCTAHEDRON, OCTAHEDRON + 6]), vertices=12)
    vertices = together.refine(torch.cat([CORNERS, CORNERS + 5.0]))
    alone, _ = refined(CORNERS, OCTAHEDRON)
    assert torch.allclose(vertices[:6], alone[:6])
    assert torch.allclose(vertices[12:24], alone[6:])


def test_an_edge_of_three_faces_is_a_border_and_a_lone_vertex_stays():
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    vertices = torch.randn(6, 3, generator=torch.Generator().manual_seed(0))
    fine, fine_faces = refined(vertices, faces)
    assert torch.allclose(fine[5], vertices[5])
    shared = fine_faces[0, 1]
    assert torch.allclose(fine[shared], (vertices[0] + vertices[1]) / 2)


def test_corners_split_as_the_faces_do():
    vertices, faces = grid()
    flat = vertices[torch.from_numpy(faces)][..., :2]
    split = split_corners(flat)
    areas = face_areas(
        torch.nn.functional.pad(split.reshape(-1, 2), (0, 1)), torch.arange(3 * len(split)).view(-1, 3)
    )
    assert areas == pytest.approx(0.125)
    # where subdivision moves nothing, corners and vertices are at one place
    subdivision = LoopSubdivision.build(faces, vertices=len(vertices))
    middle = (split.mean(dim=1) - 2.0).abs().amax(dim=1) < 1.0
    assert torch.allclose(
        subdivision.refine(vertices)[subdivision.faces.long()][middle][..., :2], split[middle], atol=1e-6
    )


@pytest.fixture(scope="module")
def eyes():
    template = small_template()
    rest = torch.from_numpy(template.v_template)
    inside = {name: torch.zeros(len(rest), dtype=torch.bool) for name in EYEBALLS}
    for name, members in inside.items():
        members[template.masks[name]] = True
    return template, rest, Eyelids.both(template, rest, inside)


def test_lids_are_moved_out_of_the_eyeball_and_nothing_else_moves(eyes):
    template, rest, lids = eyes
    posed = Rig.build(template).pose(parameters(0), torch.zeros(template.n_shape))
    for eye in lids:
        assert len(eye.skin) >= 3
        assert eye.joint in (3, 4)
        centre = (
            posed.joint_transforms[eye.joint, :3, :3] @ eye.center + posed.joint_transforms[eye.joint, :3, 3]
        )
        outward = torch.nn.functional.normalize(posed.vertices[eye.skin] - centre, dim=1)
        vertices = posed.vertices.clone()
        # one within the eyeball, the rest far off it
        vertices[eye.skin] = centre + outward * 0.02
        vertices[eye.skin[0]] = centre + outward[0] * 0.005
        cleared = eye.clear(vertices, posed.joint_transforms)
        distance = (cleared[eye.skin[0]] - centre).norm()
        assert float(distance) == pytest.approx(0.012 + CLEARANCE, abs=2e-4)
        assert torch.allclose((cleared[eye.skin[0]] - centre) / distance, outward[0], atol=1e-4)
        others = torch.ones(len(rest), dtype=torch.bool)
        others[eye.skin[0]] = False
        assert torch.allclose(cleared[others], vertices[others], atol=1e-6)


def test_a_spheres_middle_is_found_from_a_part_of_it(eyes):
    _, _, lids = eyes
    for name, eye in zip(EYEBALLS, lids, strict=True):
        side = 1 if name.startswith("left") else -1
        direction = np.array([side * 0.35, 0.25, 0.9])
        assert eye.center.numpy() == pytest.approx(0.085 * direction / np.linalg.norm(direction), abs=1e-6)
        assert eye.radii.numpy() == pytest.approx(0.012, abs=1e-6)
