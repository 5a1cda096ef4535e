import math

import pytest
import torch

from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.rays.visibility import visible
from samira_warp.reference.rays.ray_mesh import RayMesh as PlainMesh
from samira_warp.reference.rays.visibility import visible as reference
from samira_warp.support.errors import UserError


def make_sphere(rings=24, columns=48):
    """A closed unit sphere: vertices (V, 3), faces (F, 3)."""
    polar = torch.linspace(0, math.pi, rings + 1)[:, None]
    around = 2 * math.pi * torch.arange(columns)[None] / columns
    vertices = torch.stack(
        [polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos().expand(-1, columns)], dim=-1
    )
    ring, column = (
        grid.flatten() for grid in torch.meshgrid(torch.arange(rings), torch.arange(columns), indexing="ij")
    )
    a, b = ring * columns + column, ring * columns + (column + 1) % columns
    return vertices.view(-1, 3), torch.cat(
        [torch.stack([a, a + columns, b + columns], 1), torch.stack([a, b + columns, b], 1)]
    )


def move(device, *tensors):
    return [tensor.to(device) for tensor in tensors]


def test_a_convex_body_hides_what_faces_away(device):
    """Face centres of a sphere: seen exactly where the face's plane has the viewpoint in front."""
    vertices, faces = make_sphere()
    a, b, c = vertices[faces].unbind(dim=1)
    centres, normals = (a + b + c) / 3, torch.linalg.cross(b - a, c - a)
    keep = normals.norm(dim=1) > 1e-6
    centres, normals = centres[keep], torch.nn.functional.normalize(normals[keep], dim=1)
    origin = torch.tensor([0.7, 0.4, 3.0])
    facing = (normals * (origin - centres)).sum(dim=1)
    sure = facing.abs() > 0.01
    points, vertices, faces, origin = move(device, centres, vertices, faces, origin)
    seen = visible(points, RayMesh(vertices, faces), origin=origin).cpu()
    assert torch.equal(seen[sure], (facing > 0)[sure])


def test_matches_the_twin(device, generator):
    """A soup of triangles and points all about, the viewpoint amid them."""
    vertices = torch.randn(30, 3, generator=generator, dtype=torch.float64)
    faces = torch.arange(30).view(10, 3)
    points = 2 * torch.randn(2000, 3, generator=generator, dtype=torch.float64)
    origin = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64)
    expected = reference(points, PlainMesh(vertices, faces), origin=origin)
    assert 0.2 < expected.float().mean() < 0.8
    points, vertices, faces, origin = move(device, points.float(), vertices.float(), faces, origin.float())
    found = visible(points, RayMesh(vertices, faces), origin=origin).cpu()
    # Rays that graze an edge to within 1e-6 may go either way: of 2,000 rays and 30 edges, hardly one.
    assert (found != expected).sum() <= 1


@pytest.mark.parametrize("order", [[0, 1, 2], [0, 2, 1]])
def test_triangles_block_from_both_sides(device, order):
    vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]], device=device)
    points = torch.tensor([[0.0, 0, -1], [0, 0, 0.5], [3, 0, -1], [0.0, 0, 2]], device=device)
    mesh = RayMesh(vertices, torch.tensor([order], device=device))
    before, behind = torch.tensor([[0.0, 0, 1], [0.0, 0, -1]], device=device)
    assert visible(points, mesh, origin=before).tolist() == [False, True, True, True]
    assert visible(points, mesh, origin=behind).tolist() == [True, False, True, False]


def test_the_surface_does_not_hide_its_own_points(device, generator):
    """Points of a triangle, moved by rounding to either side, from a metre away; a lid 1 mm before them does
    hide them."""
    triangle = torch.tensor([[-0.05, -0.04, 0.02], [0.06, -0.03, -0.01], [0.0, 0.07, 0.03]])
    weights = torch.rand(3000, 3, generator=generator)
    points = weights / weights.sum(dim=1, keepdim=True) @ triangle
    toward = torch.tensor([0.1, 0.2, 1.0])
    points, triangle, origin = move(device, points, triangle, toward)
    faces = torch.tensor([[0, 1, 2]], device=device)
    assert bool(visible(points, RayMesh(triangle, faces), origin=origin).all())
    lid = (
        3 * (triangle - triangle.mean(dim=0))
        + triangle.mean(dim=0)
        + torch.tensor([0.0, 0.0, 0.001], device=device)
    )
    assert not bool(visible(points, RayMesh(lid, faces), origin=origin).any())


def test_offset_is_what_is_left_untested(device):
    vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]], device=device)
    mesh = RayMesh(vertices, torch.tensor([[0, 1, 2]], device=device))
    origin, points = torch.tensor([[[0.0, 0, 1]], [[0.0, 0, -0.01]]], device=device)
    assert visible(points, mesh, origin=origin[0], offset=0.02).tolist() == [True]
    assert visible(points, mesh, origin=origin[0], offset=0.005).tolist() == [False]


def test_same_bits_for_any_threads_and_runs(device, generator):
    vertices, faces = make_sphere()
    points = 1.5 * torch.randn(8000, 3, generator=generator)
    points, vertices, faces, origin = move(device, points, vertices, faces, torch.tensor([0.0, 0.5, 3.0]))
    mesh = RayMesh(vertices, faces)
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        runs.append(visible(points, mesh, origin=origin))
    torch.set_num_threads(before)
    assert torch.equal(runs[0], runs[1])
    assert torch.equal(runs[1], runs[2])


def test_nothing_between(device):
    """No triangles, one without area, and points nearer to the viewpoint than the offset."""
    vertices, origin = torch.zeros(3, 3, device=device), torch.tensor([0.0, 0, 1], device=device)
    point = RayMesh(vertices, torch.tensor([[0, 1, 2]], device=device))
    empty = RayMesh(vertices, torch.empty(0, 3, dtype=torch.int64, device=device))
    points = torch.tensor([[0.0, 0, -1], [0, 0, 1], [0, 0, 1 + 1e-6]], device=device)
    for mesh in (empty, point):
        assert visible(points, mesh, origin=origin).all()
    assert visible(points[:0], point, origin=origin).shape == (0,)


def test_wrong_arguments_are_a_users_error(device):
    mesh = RayMesh(torch.zeros(3, 3, device=device), torch.tensor([[0, 1, 2]], device=device))
    points, origin = torch.zeros(2, 3, device=device), torch.zeros(3, device=device)
    for wrong in (points[:, :2], points.double(), points.to("meta")):
        with pytest.raises(UserError, match="points: expected float32 tensor of shape"):
            visible(wrong, mesh, origin=origin)
    for wrong in (origin[None], origin.double(), origin.to("meta")):
        with pytest.raises(UserError, match="origin: expected float32 tensor of shape"):
            visible(points, mesh, origin=wrong)
