import pytest
import torch
from kernels.meshes import rectangle, sphere

from samira_warp.geometry.mesh import vertex_normals
from samira_warp.kernels import MeshTopology, mesh_normals
from samira_warp.reference.mesh.mesh_normals import mesh_normals as reference


def bumpy(generator, device, frames=3):
    """(B, V, 3) spheres whose vertices are moved, each frame's in its own way, and their topology."""
    vertices, faces = sphere()
    noise = 0.05 * torch.randn(frames, len(vertices), 3, generator=generator)
    return (vertices + noise).to(device), MeshTopology.build(faces.to(device), len(vertices))


def test_matches_the_twin_and_its_gradient(device, generator):
    vertices, topology = bumpy(generator, device)
    leaf, exact = vertices.clone().requires_grad_(), vertices.double().requires_grad_()
    found, expected = mesh_normals(leaf, topology), reference(exact, topology)
    # sums of area vectors of 0.1, of lengths good to 6e-8
    assert torch.allclose(found.double(), expected, rtol=0, atol=3e-6)
    weights = torch.randn(found.shape, generator=generator).to(device)
    (grad,) = torch.autograd.grad(found, leaf, weights)
    (exact_grad,) = torch.autograd.grad(expected, exact, weights.double())
    assert (grad - exact_grad).norm() < 1e-5 * exact_grad.norm()


def test_twin_by_finite_differences(generator):
    vertices, topology = bumpy(generator, "cpu", frames=2)
    assert torch.autograd.gradcheck(
        lambda vertices: reference(vertices, topology), vertices.double().requires_grad_(), fast_mode=True
    )


def test_frames_are_meshes_one_by_one(device, generator):
    vertices, topology = bumpy(generator, device)
    alone = torch.stack([vertex_normals(frame.double(), topology.faces) for frame in vertices])
    assert torch.allclose(mesh_normals(vertices, topology).double(), alone, rtol=0, atol=3e-6)


def test_a_spheres_normals_are_its_radii(device):
    vertices, faces = sphere(rings=40, sectors=60)
    topology = MeshTopology.build(faces.to(device), len(vertices))
    normals = mesh_normals(vertices[None].to(device), topology)[0].cpu()
    # flat triangles of a degree and a half by two turn from the sphere by up to 3 degrees
    cosine = (normals * vertices).sum(dim=1)
    assert cosine.min() > 0.998
    assert torch.allclose(normals.norm(dim=1), torch.ones(len(vertices)), rtol=0, atol=1e-6)


def test_no_triangle_no_normal(device):
    """A vertex of none, and one of a triangle without area: 0, with no gradient."""
    points, faces = rectangle(0, 0, 1, 1)
    points = torch.cat([points, torch.tensor([[5.0, 5, 5]]), torch.ones(3, 3)])
    topology = MeshTopology.build(torch.cat([faces, torch.tensor([[5, 6, 7]])]).to(device), 8)
    leaf = points[None].to(device).requires_grad_()
    normals = mesh_normals(leaf, topology)
    assert not normals[0, 4:].any()
    (grad,) = torch.autograd.grad((normals * torch.rand_like(normals)).sum(), leaf)
    assert grad.isfinite().all()
    assert grad[0, :4].any()
    assert not grad[0, 4:].any()


def test_same_bits_for_any_threads_and_runs(device, generator, use_threads):
    vertices, faces = sphere(rings=40, sectors=60)
    topology = MeshTopology.build(faces.to(device), len(vertices))
    batch = (vertices + 0.01 * torch.randn(4, *vertices.shape, generator=generator)).to(device)
    weights = torch.randn(batch.shape, generator=generator).to(device)
    runs = []
    for threads in (1, 2, 3, 2):
        use_threads(threads)
        leaf = batch.clone().requires_grad_()
        normals = mesh_normals(leaf, topology)
        runs.append((normals, *torch.autograd.grad(normals, leaf, weights)))
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


@pytest.mark.parametrize(("frames", "faces"), [(0, 2), (2, 0)])
def test_no_frames_and_no_triangles(device, frames, faces):
    leaf = torch.ones(frames, 4, 3, device=device, requires_grad=True)
    topology = MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device)[:faces], 4)
    normals = mesh_normals(leaf, topology)
    assert normals.shape == leaf.shape
    assert not normals.any()
    (grad,) = torch.autograd.grad(normals.sum(), leaf)
    assert not grad.any()
