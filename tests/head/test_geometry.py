import math

import pytest
import torch

from samira_warp.geometry.mesh import face_areas, vertex_normals

TETRAHEDRON = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
OUTWARD = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_a_corner_of_a_cube(device):
    """Areas 1/2, 1/2, 1/2 and sqrt(3)/2; normals weighted by area, by hand."""
    vertices, faces = TETRAHEDRON.to(device), OUTWARD.to(device)
    assert torch.allclose(
        face_areas(vertices, faces).cpu(),
        torch.tensor([0.5, 0.5, 0.5, math.sqrt(3) / 2], dtype=torch.float64),
    )
    # Doubled areas times normals: -z, -y, -x, and (1, 1, 1) for the slanted face. Vertex 1 misses the face in
    # x = 0.
    sums = torch.tensor([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    assert torch.allclose(
        vertex_normals(vertices, faces).cpu(), torch.nn.functional.normalize(sums, dim=1), rtol=0, atol=1e-12
    )


def test_turns_with_the_mesh_and_with_the_winding(generator):
    vertices = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    faces = torch.randint(50, (200, 3), generator=generator)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]
    turn = turn * torch.linalg.det(turn)
    normals = vertex_normals(vertices, faces)
    assert torch.allclose(vertex_normals(vertices @ turn.T + 1, faces), normals @ turn.T, rtol=0, atol=1e-9)
    assert torch.allclose(vertex_normals(vertices, faces[:, [0, 2, 1]]), -normals, rtol=0, atol=1e-9)
    assert torch.allclose(face_areas(3 * vertices @ turn.T, faces), 9 * face_areas(vertices, faces))


def test_millimetre_faces_have_unit_normals_in_float32():
    normals = vertex_normals(1e-4 * TETRAHEDRON.float(), OUTWARD)
    assert torch.allclose(normals.norm(dim=1), torch.ones(4), rtol=0, atol=1e-6)


def test_without_faces_no_normal(device):
    """A vertex that no face uses, or only degenerate ones, has the normal 0."""
    vertices = torch.cat([TETRAHEDRON, torch.ones(2, 3)]).to(device)
    faces = torch.cat([OUTWARD, torch.tensor([[5, 5, 5]])]).to(device)
    assert not vertex_normals(vertices, faces)[4:].any()
    assert face_areas(vertices, faces)[4] == 0


@pytest.mark.parametrize("function", [vertex_normals, face_areas])
def test_gradients(function):
    vertices = TETRAHEDRON.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda vertices: function(vertices, OUTWARD), vertices)
