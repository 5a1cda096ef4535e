import math

import pytest
import torch
from kernels.meshes import rectangle, scene, seen, sphere, two_spheres

from samira_subject.head import build_template
from samira_warp.kernels import MeshTopology, antialias, interpolate, rasterize_mesh
from samira_warp.kernels.mesh import outlines
from samira_warp.kernels.mesh.mesh_raster import NOTHING
from samira_warp.kernels.runtime import launch
from samira_warp.reference.mesh.antialias import antialias as reference
from samira_warp.reference.mesh.mesh_raster import rasterize_mesh as reference_raster

SIZE = {"width": 40, "height": 30}


def coverage(points, topology, *, width, height, colors=None):
    """(B, H, W, C) of a mesh in its own colours, or in white, on black."""
    raster = rasterize_mesh(points, topology, width=width, height=height)
    colors = points.new_ones(points.shape[1], 1) if colors is None else colors
    return antialias(interpolate(colors, raster, topology), raster, points, topology)


def test_matches_the_twin_and_its_gradient(device, generator):
    points, topology = two_spheres(generator, device)
    image = torch.rand(2, 30, 40, 3, generator=generator).to(device)
    leaves = [image.clone().requires_grad_(), points.clone().requires_grad_()]
    exact = [image.double().requires_grad_(), points.double().requires_grad_()]
    found = antialias(leaves[0], rasterize_mesh(points, topology, **SIZE), leaves[1], topology)
    expected = reference(exact[0], reference_raster(points.double(), topology, **SIZE), exact[1], topology)
    assert (expected != exact[0]).any(dim=-1).sum() > 150
    # crossings to 2^-19, an ulp of coordinates of 40, over what an edge spans
    assert torch.allclose(found.double(), expected, rtol=0, atol=1e-5)
    weights = torch.randn(image.shape, generator=generator).to(device)
    grads = torch.autograd.grad(found, leaves, weights)
    exact_grads = torch.autograd.grad(expected, exact, weights.double())
    for grad, exact_grad in zip(grads, exact_grads, strict=True):
        assert (grad - exact_grad).norm() < 1e-5 * exact_grad.norm()
    assert not grads[1][..., 2].any()


def test_twin_by_finite_differences(generator):
    points, topology = scene(rectangle(1.2, 1.7, 4.3, 3.9), device="cpu")
    points = points.double()
    points[..., 0] += 0.13 * points[..., 1]
    raster = reference_raster(points, topology, width=6, height=5)
    image = torch.rand(1, 5, 6, 2, generator=generator, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda image, points: reference(image, raster, points, topology), (image, points.requires_grad_())
    )


@pytest.mark.parametrize("edge", [10.0, 10.2, 10.5, 10.9])
def test_a_straight_edge_covers_its_share_of_a_pixel(device, edge):
    """And its neighbours all or nothing; in rows and in columns."""
    expected = (edge - torch.arange(20)).clamp(0, 1)
    for turned in (False, True):
        points, topology = scene(rectangle(-5, -5, edge, 25), device=device)
        if turned:
            points = points[..., [1, 0, 2]]
        image = coverage(points, topology, width=20, height=20)[0, ..., 0].cpu()
        # ulps of 10 over the edge's 30 pixels
        assert torch.allclose(image.T if turned else image, expected.expand(20, 20), rtol=0, atol=1e-5)


def test_colours_move_with_an_edge_before_another_surface(device):
    near, far = rectangle(-5, -5, 10.2, 25, depth=1.0), rectangle(-5, -5, 25, 25, depth=2.0)
    points, topology = scene(near, far, device=device)
    colors = torch.tensor([[0.9]] * 4 + [[0.4]] * 4, device=device)
    leaf = points.requires_grad_()
    image = coverage(leaf, topology, width=20, height=20, colors=colors)
    assert image[0, 3, 10].item() == pytest.approx(0.2 * 0.9 + 0.8 * 0.4, abs=1e-6)
    (grad,) = torch.autograd.grad(image.sum(), leaf)
    # 20 rows that gain 0.9 and lose 0.4 for each pixel that the edge moves
    assert grad[0, [1, 3], 0].sum().item() == pytest.approx(20 * 0.5, rel=1e-5)
    # the other ends of its edges lie outside; what is left is rounding, of triangles of one colour each
    assert grad[0, [0, 2]].abs().max() < 1e-5
    assert grad[0, 4:].abs().max() < 1e-5


def disc(radius, center, sectors=300, depth=1.0):
    angle = torch.arange(sectors) * (2 * math.pi / sectors)
    rim = torch.stack([center[0] + radius * angle.cos(), center[1] + radius * angle.sin()], dim=1)
    points = torch.cat([torch.tensor([center]), rim])
    at = torch.arange(sectors)
    faces = torch.stack([torch.zeros_like(at), at + 1, (at + 1) % sectors + 1], dim=1)
    return torch.cat([points, torch.full((sectors + 1, 1), depth)], dim=1), faces


def test_the_derivative_of_a_discs_area_is_its_perimeter(device):
    """Of triangles that are much narrower than a pixel at the rim."""
    points, topology = scene(disc(17.3, (24.9, 25.4)), device=device)
    scale = torch.ones((), device=device, requires_grad=True)
    shift = torch.zeros(2, device=device, requires_grad=True)
    center = points[:, :1, :2]
    moved = torch.cat([center + scale * (points[..., :2] - center) + shift, points[..., 2:]], dim=-1)
    image = coverage(moved, topology, width=50, height=50)
    # blended, coverage is a sum over lines of pixels of what lies between crossings: the trapezoidal rule
    assert image.sum().item() == pytest.approx(math.pi * 17.3**2, rel=2e-3)
    grown, drifted = torch.autograd.grad(image.sum(), (scale, shift), retain_graph=True)
    assert grown.item() == pytest.approx(17.3 * 2 * math.pi * 17.3, rel=0.01)
    # what is won on one side is lost on the other: pixels' worth of lines that one has and the other has not
    assert drifted.abs().max() < 3
    # the first moment of a shape that moves by a pixel grows by its area
    x = torch.arange(50, device=device) + 0.5
    (moment,) = torch.autograd.grad((image[0, ..., 0] * x).sum(), shift)
    assert moment[0].item() == pytest.approx(math.pi * 17.3**2, rel=0.02)


def head(device, size, angle):
    """The built-in head, turned, in the middle of an image: most triangles are smaller than a pixel."""
    template = build_template()
    vertices = torch.from_numpy(template.v_template)
    vertices = vertices - vertices.mean(dim=0)
    turn = torch.tensor(
        [[math.cos(angle), 0, math.sin(angle)], [0, -1, 0], [math.sin(angle), 0, -math.cos(angle)]]
    )
    points = seen(vertices @ turn.T, focal=2.6 * size, depth=1.0, center=(size / 2, size / 2), radius=1.0)
    return points.to(device), MeshTopology.build(torch.from_numpy(template.faces).to(device), len(vertices))


def test_a_heads_outline_pulls_as_its_area_does(device, generator):
    """Closed forms of any outline: area grows as the square of the scale, first moments with the shift."""
    size, count, samples = 64, 12, 8
    frames, topologies = zip(*(head(device, size, 0.25 * index - 1.4) for index in range(count)), strict=True)
    points, topology = torch.stack(frames), topologies[0]
    points[..., :2] += torch.rand(count, 1, 2, generator=generator).to(device)
    scale = torch.ones(count, 1, 1, device=device, requires_grad=True)
    shift = torch.zeros(count, 1, 2, device=device, requires_grad=True)
    middle = size / 2
    moved = torch.cat([middle + scale * (points[..., :2] - middle) + shift, points[..., 2:]], dim=-1)
    image = coverage(moved, topology, width=size, height=size)[..., 0]

    # the truth, by many samples in every pixel
    fine = points * points.new_tensor([samples, samples, 1.0])
    truth = (rasterize_mesh(fine, topology, width=samples * size, height=samples * size).face >= 0).float()
    truth = truth.view(count, size, samples, size, samples).mean(dim=(2, 4))
    area = truth.sum(dim=(1, 2))
    assert torch.allclose(image.sum(dim=(1, 2)), area, rtol=2e-3)
    # no pixel of an outline goes without: unblended, its error is a quarter on average
    partial = (truth > 0.05) & (truth < 0.95)
    assert (image - truth).abs()[partial].mean() < 0.05

    x = torch.arange(size, device=device) + 0.5
    (grown,) = torch.autograd.grad(image.sum(), scale, retain_graph=True)
    (moment_x,) = torch.autograd.grad((image * x).sum(), shift, retain_graph=True)
    (moment_y,) = torch.autograd.grad((image * x[:, None]).sum(), shift)
    # Where an outline turns from steep to flat, a line of pixels may be met twice or not at all: some two
    # pixels' worth, each weighing up to the image's size, in 1000 to 1300; by chance, so less in the mean.
    for found, expected in ((grown[:, 0, 0], 2 * area), (moment_x[:, 0, 0], area), (moment_y[:, 0, 1], area)):
        assert torch.allclose(found, expected, atol=2.5 * size, rtol=0)
        assert found.mean().item() == pytest.approx(expected.mean().item(), rel=0.02)


def test_an_outline_by_finite_differences(device, generator):
    """A smooth function of the picture, and a sphere a little to both sides."""
    vertices, faces = sphere(rings=20, sectors=30)
    vertices = vertices @ torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    points = seen(vertices, focal=100, depth=1.2, center=(44.4, 51.3)).to(device)
    topology = MeshTopology.build(faces.to(device), len(vertices))
    x = torch.arange(96, device=device) + 0.5
    weights = (x / 9).sin()[None, :, None] * (x / 13).cos()[:, None, None]

    def loss(points):
        return (coverage(points[None], topology, width=96, height=96).double() * weights).sum()

    zero = torch.zeros_like(points[:, 0])
    directions = {
        "right": torch.stack([zero + 1, zero, zero], dim=1),
        "down": torch.stack([zero, zero + 1, zero], dim=1),
        "wider": torch.stack([points[:, 0] - 48, zero, zero], dim=1) / 48,
        "sheared": torch.stack([points[:, 1] - 48, zero, zero], dim=1) / 48,
    }
    leaf = points.clone().requires_grad_()
    (grad,) = torch.autograd.grad(loss(leaf), leaf)
    for direction in directions.values():
        step = 0.004
        slope = (loss(points + step * direction) - loss(points - step * direction)) / (2 * step)
        # some 150 crossings, each good to 4e-6 pixels, over 0.008: 0.01
        assert slope.item() == pytest.approx((grad.double() * direction).sum().item(), rel=0.01, abs=0.02)


def test_what_is_hidden_blends_nothing(device):
    """A square behind a larger one, and the edges within both."""
    front, hidden = rectangle(-5, -5, 45, 35, depth=1.0, cells=4), rectangle(8.2, 7.3, 20.6, 22.1, depth=2.0)
    points, topology = scene(front, hidden, device=device)
    image = torch.rand(1, 30, 40, 3, device=device)
    raster = rasterize_mesh(points, topology, **SIZE)
    leaf = points.clone().requires_grad_()
    found = antialias(image, raster, leaf, topology)
    assert torch.equal(found, image)
    (grad,) = torch.autograd.grad(found.sum(), leaf)
    assert not grad.any()


def test_blending_and_its_adjoint_are_transposes(device, generator):
    points, topology = two_spheres(generator, device)
    raster = rasterize_mesh(points, topology, **SIZE)
    x = torch.randn(2, 30, 40, 3, generator=generator).to(device).requires_grad_()
    y = torch.randn(2, 30, 40, 3, generator=generator).to(device)
    found = antialias(x, raster, points, topology)
    (back,) = torch.autograd.grad(found, x, y)
    there, here = (found.double() * y).sum(), (x.double() * back).sum()
    # two sums of some thousand terms of about 1
    assert abs(there - here) < 1e-6 * (found.norm() * y.norm())


def test_an_image_of_one_colour_stays(device, generator):
    points, topology = two_spheres(generator, device)
    image = torch.full((2, 30, 40, 1), 0.7, device=device)
    assert torch.equal(antialias(image, rasterize_mesh(points, topology, **SIZE), points, topology), image)


def test_an_outline_that_is_partly_outside(device):
    """Edges that leave the image blend what is within it."""
    points, topology = scene(disc(40.0, (-8.0, 15.0)), device=device)
    leaf = points.clone().requires_grad_()
    image = coverage(leaf, topology, **SIZE)
    assert image.isfinite().all()
    (grad,) = torch.autograd.grad(image.sum(), leaf)
    # 30 rows' worth of an outline, that moves to the right
    assert grad[..., 0].sum().item() == pytest.approx(30, rel=0.02)


@pytest.mark.parametrize("frames", [1, 3])
def test_same_bits_for_any_threads_and_runs(device, generator, use_threads, frames):
    vertices, faces = sphere(rings=30, sectors=40)
    topology = MeshTopology.build(faces.to(device), len(vertices))
    shifts = torch.rand(frames, 1, 3, generator=generator) * torch.tensor([9.0, 9.0, 0.0])
    points = (seen(vertices, focal=150, depth=1.2, center=(45.0, 45.0)) + shifts).to(device)
    image = torch.randn(frames, 100, 101, 3, generator=generator).to(device)
    weights = torch.randn(frames, 100, 101, 3, generator=generator).to(device)
    runs = []
    for threads in (1, 2, 3, 2):
        use_threads(threads)
        leaves = [image.clone().requires_grad_(), points.clone().requires_grad_()]
        raster = rasterize_mesh(points, topology, width=101, height=100)
        found = antialias(leaves[0], raster, leaves[1], topology)
        runs.append((found, *torch.autograd.grad(found, leaves, weights)))
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


def test_edges_at_once_are_frames_one_by_one(generator):
    """The kernel of a GPU, in the CPU's order and with its minima."""
    points, topology = two_spheres(generator, "cpu")
    raster = rasterize_mesh(points, topology, **SIZE)
    found = outlines.find_outlines(points, raster.face, raster.barycentrics, topology)
    at_once = torch.full_like(found.outermost, NOTHING.value), torch.zeros_like(found.crosses)
    ends, opposites, _ = topology.edges
    seen_by = (*SIZE.values(), raster.face.view(-1), raster.barycentrics.view(-1, 3))
    walked = (points, topology.faces, ends, opposites, *seen_by, *at_once)
    launch(outlines._walk_edge, 2 * len(ends), 0, *walked)
    assert found.crosses.any()
    assert all(torch.equal(one, other) for one, other in zip(found, at_once, strict=True))


@pytest.mark.parametrize(("frames", "faces"), [(0, 2), (2, 0), (0, 0)])
def test_no_frames_and_no_triangles(device, frames, faces):
    points = torch.ones(frames, 4, 3, device=device, requires_grad=True)
    image = torch.ones(frames, 30, 40, 3, device=device, requires_grad=True)
    topology = MeshTopology.build(torch.tensor([[0, 1, 2], [1, 2, 3]], device=device)[:faces], 4)
    found = antialias(image, rasterize_mesh(points, topology, **SIZE), points, topology)
    assert torch.equal(found, image)
    grads = torch.autograd.grad(found.sum(), (image, points))
    assert torch.equal(grads[0], torch.ones_like(image))
    assert not grads[1].any()
