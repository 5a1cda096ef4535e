import pytest
import torch
from kernels.meshes import rectangle, scene, seen, sphere, two_spheres

from samira_warp.kernels import MeshTopology, interpolate, rasterize_mesh
from samira_warp.kernels.mesh import mesh_raster
from samira_warp.kernels.runtime import launch
from samira_warp.reference.mesh.interpolate import interpolate as reference_interpolate
from samira_warp.reference.mesh.mesh_raster import rasterize_mesh as reference
from samira_warp.support.constants import NEAR_PLANE
from samira_warp.support.errors import UserError

SIZE = {"width": 40, "height": 30}


def relative(found, expected):
    return ((found.double() - expected).norm() / expected.norm()).item()


def test_matches_the_twin_and_its_gradient(device, generator):
    points, topology = two_spheres(generator, device)
    leaf, exact = points.clone().requires_grad_(), points.double().requires_grad_()
    found, expected = rasterize_mesh(leaf, topology, **SIZE), reference(exact, topology, **SIZE)
    assert torch.equal(found.face, expected.face)
    assert len(found.face.unique()) > 100
    # areas of some pixels^2 from coordinates of 40, good to 2^-19: 1e-6, in triangles of a few pixels
    assert torch.allclose(found.barycentrics.double(), expected.barycentrics, rtol=0, atol=3e-6)
    weights = torch.randn(found.barycentrics.shape, generator=generator).to(device)
    (grad,) = torch.autograd.grad(found.barycentrics, leaf, weights)
    (exact_grad,) = torch.autograd.grad(expected.barycentrics, exact, weights.double())
    assert relative(grad, exact_grad) < 1e-5


def test_twin_by_finite_differences():
    points, topology = scene(rectangle(-3.2, -2.1, 9.3, 8.4), device="cpu")
    points = points.double()
    # a tilt, so that the weights of space are not those of the screen
    points[0, :, 2] += 0.02 * points[0, :, 0] + 0.03 * points[0, :, 1]
    assert torch.autograd.gradcheck(
        lambda points: reference(points, topology, width=6, height=5).barycentrics, points.requires_grad_()
    )


def test_gradient_by_finite_differences(device, generator):
    """Every pixel shows the same triangle before and after: what it shows is smooth."""
    points, topology = scene(rectangle(-5.2, -4.1, 20.3, 18.4), device=device)
    points[0, :, 2] += 0.02 * points[0, :, 0]
    colors = torch.rand(4, 3, generator=generator).to(device)
    # away from the diagonal, where the triangle changes
    weights = torch.randn(1, 9, 11, 3, generator=generator).to(device)
    first = rasterize_mesh(points, topology, width=11, height=9).face

    def loss(points):
        raster = rasterize_mesh(points, topology, width=11, height=9)
        inner = (raster.face == first)[..., None]
        assert inner.all()
        return (interpolate(colors, raster, topology).double() * weights).sum()

    leaf = points.clone().requires_grad_()
    (grad,) = torch.autograd.grad(loss(leaf), leaf)
    for vertex, axis in ((0, 0), (1, 1), (2, 2), (3, 0)):
        # no centre lies within 0.05 pixels of the diagonal
        step = torch.zeros_like(points)
        step[0, vertex, axis] = 0.01 if axis < 2 else 0.004
        slope = (loss(points + step) - loss(points - step)) / (2 * step.sum())
        # float32 colours of 1 are good to 6e-8: 99 pixels over steps of 0.01 leave 6e-4 at the worst
        assert slope.item() == pytest.approx(grad[0, vertex, axis].item(), rel=2e-3, abs=1e-3)


def test_weights_are_those_of_space(device):
    """The point that they give of the mesh in space is seen at the pixel's centre."""
    vertices, faces = sphere()
    points = seen(vertices, focal=60, depth=1.2, center=(20.0, 15.0)).to(device)[None]
    topology = MeshTopology.build(faces.to(device), len(vertices))
    raster = rasterize_mesh(points, topology, **SIZE)
    position = interpolate((0.3 * vertices + torch.tensor([0, 0, 1.2])).to(device), raster, topology)
    found = (60 * position[..., :2] / position[..., 2:]) + torch.tensor([20.0, 15.0], device=device)
    x, y = torch.arange(40, device=device) + 0.5, torch.arange(30, device=device) + 0.5
    centers = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    inside = raster.face[0] >= 0
    assert inside.sum() > 500
    # weights good to 3e-6 of triangles of up to 8 pixels
    assert torch.allclose(found[0][inside], centers[inside], rtol=0, atol=5e-5)


def test_a_closed_surface_has_no_hole(device):
    vertices, faces = sphere(rings=40, sectors=60)
    points = seen(vertices, focal=150, depth=1.2, center=(50.0, 50.0)).to(device)[None]
    raster = rasterize_mesh(
        points, MeshTopology.build(faces.to(device), len(vertices)), width=100, height=100
    )
    covered = (raster.face[0] >= 0).cpu()
    columns = torch.arange(100)
    for row in covered[covered.any(dim=1)]:
        assert row.sum() == columns[row].max() - columns[row].min() + 1
    # the sphere's outline: radius 150 * 0.3 / sqrt(1.2^2 - 0.3^2)
    assert covered.sum().item() == pytest.approx(torch.pi * (45 / 1.35**0.5) ** 2, rel=0.01)


def test_edges_through_centres_leave_no_gap(device):
    """A grid whose vertices and diagonals lie on pixel centres: every pixel within shows a triangle."""
    points, topology = scene(rectangle(0.5, 0.5, 24.5, 24.5, cells=8), device=device)
    raster = rasterize_mesh(points, topology, width=30, height=30)
    expected = torch.zeros(30, 30, dtype=torch.bool)
    expected[:25, :25] = True
    assert torch.equal((raster.face[0] >= 0).cpu(), expected)
    assert torch.allclose(raster.barycentrics.sum(dim=-1)[0].cpu(), expected.float(), rtol=0, atol=1e-6)


def test_the_nearest_wins_and_then_the_lowest(device):
    near, far = rectangle(5, 5, 15, 15, depth=1.0), rectangle(2, 2, 25, 20, depth=2.0)
    points, topology = scene(far, near, near, device=device)
    face = rasterize_mesh(points, topology, **SIZE).face[0]
    assert set(face[5:15, 5:15].unique().tolist()) == {2, 3}
    assert set(face[face >= 0].unique().tolist()) == {0, 1, 2, 3}


def test_both_sides_are_seen(device):
    points, topology = scene(rectangle(5, 5, 15, 15), device=device)
    turned = MeshTopology.build(topology.faces[:, [0, 2, 1]], 4)
    assert torch.equal(
        rasterize_mesh(points, topology, **SIZE).face, rasterize_mesh(points, turned, **SIZE).face
    )


HIDDEN = {
    "a point": [[8.5, 8.5, 1.0]] * 3,
    "a line": [[3.5, 3.5, 1], [9.5, 9.5, 1], [15.5, 15.5, 1]],
    "two corners in one": [[3.5, 3.5, 1], [3.5, 3.5, 1], [15.5, 15.5, 1]],
    "a corner behind the camera": [[3.0, 3, 1], [20, 3, 1], [8, 20, -0.1]],
    "a corner at the near plane": [[3.0, 3, 1], [20, 3, 1], [8, 20, NEAR_PLANE]],
    "not a number": [[3.0, 3, 1], [20, 3, 1], [8, float("nan"), 1]],
    "infinity": [[3.0, 3, 1], [20, float("inf"), 1], [8, 20, 1]],
    "left of the view": [[-30.0, 3, 1], [-20, 3, 1], [-8, 20, 1]],
    "between centres": [[3.6, 3.6, 1], [4.3, 3.6, 1], [4.0, 4.3, 1]],
    "far out": [[1e9, 3.0, 1], [2e9, 3, 1], [1e9, 20, 1]],
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_not_seen_disturbs_nothing(device, name):
    healthy = rectangle(5, 5, 15, 15, depth=2.0)
    hidden = torch.tensor(HIDDEN[name]), torch.tensor([[0, 1, 2]])
    points, topology = scene(healthy, hidden, device=device)
    leaf = points.requires_grad_()
    raster = rasterize_mesh(leaf, topology, **SIZE)
    alone, alone_topology = scene(healthy, device=device)
    assert torch.equal(raster.face, rasterize_mesh(alone, alone_topology, **SIZE).face)
    (grad,) = torch.autograd.grad(raster.barycentrics[..., 0].sum(), leaf)
    assert not grad[0, 4:].any()
    assert grad[0, :4].isfinite().all()
    assert grad[0, :4].any()


def test_interpolation_matches_the_twin(device, generator):
    points, topology = two_spheres(generator, device)
    count = points.shape[1]
    for shape in ((count, 5), (2, count, 5)):
        attributes = torch.randn(shape, generator=generator).to(device)
        leaves = [points.clone().requires_grad_(), attributes.clone().requires_grad_()]
        exact = [leaf.detach().double().requires_grad_() for leaf in leaves]
        found = interpolate(leaves[1], rasterize_mesh(leaves[0], topology, **SIZE), topology)
        expected = reference_interpolate(exact[1], reference(exact[0], topology, **SIZE), topology)
        # weights good to 3e-6, of attributes of up to 4
        assert torch.allclose(found.double(), expected, rtol=0, atol=2e-5)
        weights = torch.randn(found.shape, generator=generator).to(device)
        grads = torch.autograd.grad(found, leaves, weights)
        exact_grads = torch.autograd.grad(expected, exact, weights.double())
        for grad, exact_grad in zip(grads, exact_grads, strict=True):
            assert relative(grad, exact_grad) < 1e-5


def test_interpolation_and_its_adjoint_are_transposes(device, generator):
    points, topology = two_spheres(generator, device)
    raster = rasterize_mesh(points, topology, **SIZE)
    for shape in ((points.shape[1], 3), (2, points.shape[1], 3)):
        x = torch.randn(shape, generator=generator).to(device).requires_grad_()
        image = interpolate(x, raster, topology)
        y = torch.randn(image.shape, generator=generator).to(device)
        (back,) = torch.autograd.grad(image, x, y)
        there, here = (image.double() * y).sum(), (x.double() * back).sum()
        # two sums of some thousand terms of about 1
        assert abs(there - here) < 1e-6 * (image.norm() * y.norm())


def test_corners_may_have_attributes_of_their_own(device):
    """A UV layout: other ids, in the same triangles."""
    points, topology = scene(rectangle(5, 5, 15, 15), device=device)
    raster = rasterize_mesh(points, topology, **SIZE)
    layout = MeshTopology.build(torch.arange(6, device=device).view(2, 3), 6)
    by_face = torch.tensor([1.0, 1, 1, 2, 2, 2], device=device)[:, None]
    image = interpolate(by_face, raster, layout)
    assert torch.allclose(image[..., 0], (raster.face + 1).float(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("frames", [1, 3])
def test_same_bits_for_any_threads_and_runs(device, generator, use_threads, frames):
    vertices, faces = sphere(rings=30, sectors=40)
    topology = MeshTopology.build(faces.to(device), len(vertices))
    shifts = torch.rand(frames, 1, 3, generator=generator) * torch.tensor([9.0, 9.0, 0.0])
    points = (seen(vertices, focal=150, depth=1.2, center=(45.0, 45.0)) + shifts).to(device)
    attributes = torch.randn(len(vertices), 3, generator=generator).to(device)
    weights = torch.randn(frames, 100, 101, 3, generator=generator).to(device)
    runs = []
    for threads in (1, 2, 3, 2):
        use_threads(threads)
        leaves = [points.clone().requires_grad_(), attributes.clone().requires_grad_()]
        raster = rasterize_mesh(leaves[0], topology, width=101, height=100)
        image = interpolate(leaves[1], raster, topology)
        runs.append((*raster, image, *torch.autograd.grad(image, leaves, weights)))
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


def test_triangles_at_once_are_bands_one_by_one(generator):
    """The kernel of a GPU, in the CPU's order and with its minima."""
    points, topology = two_spheres(generator, "cpu")
    faces = topology.faces
    boxes = torch.empty(2, len(faces), 4, dtype=torch.int32)
    launch(mesh_raster._bound, boxes.shape[0] * boxes.shape[1], 0, points, faces, *SIZE.values(), boxes)
    bands = mesh_raster._draw_all(points, faces, boxes, *SIZE.values())
    at_once = torch.full_like(bands, mesh_raster.NOTHING.value)
    drawn = (points, faces, boxes, *SIZE.values(), at_once)
    launch(mesh_raster._draw_triangle, boxes.shape[0] * boxes.shape[1], 0, *drawn)
    assert torch.equal(bands, at_once)


@pytest.mark.parametrize(("frames", "faces"), [(0, 2), (2, 0), (0, 0)])
def test_no_frames_and_no_triangles(device, frames, faces):
    points = torch.ones(frames, 4, 3, device=device, requires_grad=True)
    colors = torch.ones(4, 2, device=device, requires_grad=True)
    topology = MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device)[:faces], 4)
    raster = rasterize_mesh(points, topology, **SIZE)
    assert raster.face.shape == (frames, 30, 40)
    assert (raster.face == -1).all()
    image = interpolate(colors, raster, topology)
    assert image.shape == (frames, 30, 40, 2)
    grads = torch.autograd.grad(image.sum() + raster.barycentrics.sum(), (points, colors))
    assert [grad.shape for grad in grads] == [points.shape, colors.shape]
    assert not any(grad.any() for grad in grads)


def test_a_size_of_nothing_is_a_users_error(device):
    points, topology = scene(rectangle(5, 5, 15, 15), device=device)
    with pytest.raises(UserError, match="height"):
        rasterize_mesh(points, topology, width=4, height=0)
