import math

import pytest
import torch

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.projection import project
from samira_warp.reference.raster.projection import least_sigma
from samira_warp.reference.raster.projection import project as reference_project
from samira_warp.support.constants import ALPHA_MIN, LOW_PASS, NEAR_PLANE
from samira_warp.support.errors import UserError

COUNT = 400


def make_camera(device, width=120, height=90):
    """A camera that is turned, moved and off-centre, so that no term of the projection vanishes."""
    angle = 0.3
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor(
        [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    )
    pose[:3, 3] = torch.tensor([0.05, -0.1, 1.2])
    return Camera(pose.to(device), 150.0, 130.0, 0.45 * width, 0.55 * height, width, height)


def make_gaussians(generator, device, count=COUNT, spread=0.35):
    means = spread * torch.randn(count, 3, generator=generator)
    quaternions = 2.0 * torch.randn(count, 4, generator=generator)
    scales = 0.05 * torch.exp(0.8 * torch.randn(count, 3, generator=generator))
    opacities = torch.rand(count, generator=generator)
    return [tensor.to(device) for tensor in (means, quaternions, scales, opacities)]


def relative(found, expected):
    return ((found.double() - expected).norm() / expected.norm()).item()


def test_values_match_the_twin(device, generator):
    gaussians, camera = make_gaussians(generator, device), make_camera(device)
    found = project(*gaussians, camera)
    expected = reference_project(*(tensor.double() for tensor in gaussians), camera)
    both = found.visible & expected.visible
    # the kernel's ellipse has a margin of 1e-3 + 1e-4 sigma: it may see a Gaussian that the twin just misses,
    # never the reverse
    assert not (expected.visible & ~found.visible).any()
    assert (found.visible & ~expected.visible).sum() <= 2
    assert both.sum() > COUNT / 3
    assert (~both).sum() > COUNT / 20
    # float32 rounds 2^-24 relative per operation; some twenty operations, and a factor ten for the conics'
    # products of covariances
    assert relative(found.means2d[both], expected.means2d[both]) < 1e-6
    assert relative(found.depths[both], expected.depths[both]) < 1e-6
    assert relative(found.conics[both], expected.conics[both]) < 1e-5


def test_gradients_match_the_twin(device, generator):
    gaussians, camera = make_gaussians(generator, device), make_camera(device)
    gaussians[2][::5] *= 20.0  # wide enough to be seen from where the Jacobian's slopes are clamped
    visible = reference_project(*(tensor.double() for tensor in gaussians), camera).visible
    point = gaussians[0] @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    clamped = visible & ((point[:, 0] / point[:, 2]).abs() > 1.3 * 0.55 * camera.width / camera.fx)
    assert clamped.sum() > 3

    weights = [torch.randn(COUNT, *shape, generator=generator).to(device) for shape in ((2,), (), (3,), ())]
    weights = [torch.where(visible.view(-1, *[1] * (weight.dim() - 1)), weight, 0.0) for weight in weights]
    results = []
    for function, dtype in ((project, torch.float32), (reference_project, torch.float64)):
        inputs = [tensor.to(dtype).requires_grad_() for tensor in gaussians]
        projection = function(*inputs, camera)
        loss = sum(
            (result * weight.to(dtype)).sum() for result, weight in zip(projection[:4], weights, strict=True)
        )
        results.append(torch.autograd.grad(loss, inputs))
    for found, expected in zip(*results, strict=True):
        # inverse scales of up to a hundredfold cancel in the chain through K; single terms missing would show
        # as 0.1 and more
        assert relative(found, expected) < 1e-4
        assert (
            torch.nn.functional.cosine_similarity(found.double().flatten(), expected.flatten(), dim=0)
            > 1 - 1e-8
        )


def test_gradients_match_finite_differences(generator):
    gaussians, camera = make_gaussians(generator, "cpu", count=6, spread=0.1), make_camera("cpu")
    gaussians[3].clamp_(min=0.1)
    inputs = [tensor.double().requires_grad_() for tensor in gaussians]

    def results(*tensors):
        return reference_project(*tensors, camera)[:4]

    assert torch.autograd.gradcheck(results, inputs, eps=1e-6, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        (0, math.nan),
        (0, math.inf),
        (0, 1e30),
        (1, math.nan),
        (1, 0.0),
        (2, math.nan),
        (2, math.inf),
        (2, 1e30),
        (3, math.nan),
        (3, 0.0),
    ],
)
def test_unusable_gaussians_are_culled_without_a_trace(device, generator, field, value):
    gaussians, camera = make_gaussians(generator, device, count=20, spread=0.05), make_camera(device)
    gaussians[3].clamp_(min=0.1)
    healthy = project(*gaussians, camera)
    assert healthy.visible.all()
    gaussians[field][7] = value
    inputs = [tensor.clone().requires_grad_() for tensor in gaussians]
    projection = project(*inputs, camera)
    assert projection.visible.tolist() == [i != 7 for i in range(20)]
    others = projection.visible
    for found, expected in zip(projection[:4], healthy[:4], strict=True):
        assert torch.equal(found[others], expected[others])
        assert (found[7] == 0).all()
    gradients = torch.autograd.grad(sum((result * result).sum() for result in projection[:4]), inputs)
    for gradient in gradients:
        assert gradient.isfinite().all()
        assert (gradient[7] == 0).all()


def test_depth_decides_at_the_near_plane(device):
    camera = Camera(torch.eye(4, device=device), 50.0, 50.0, 16.0, 16.0, 32, 32)
    depths = torch.tensor([-1.0, 0.0, NEAR_PLANE, NEAR_PLANE * 1.01, 1.0], device=device)
    means = torch.stack([torch.zeros_like(depths), torch.zeros_like(depths), depths], dim=-1)
    quaternions = torch.tensor([[1.0, 0, 0, 0]], device=device).expand(5, 4)
    visible = project(
        means, quaternions, torch.full((5, 3), 1e-3, device=device), torch.ones(5, device=device), camera
    ).visible
    assert visible.tolist() == [False, False, False, True, True]


@pytest.mark.parametrize("pixels", [0.05, 0.5, 5.0])
def test_low_pass_keeps_what_a_disc_adds_to_the_image(device, pixels):
    """A disc that faces the camera adds 2 pi sigma^2 times its opacity, whatever the low-pass makes of it."""
    camera = Camera(torch.eye(4, device=device), 50.0, 50.0, 16.0, 16.0, 32, 32)
    gaussian = [[0.0, 0, 1]], [[1.0, 0, 0, 0]], [[pixels / 50, pixels / 50, 1e-4]], [0.8]
    projection = project(*(torch.tensor(values, device=device) for values in gaussian), camera)
    expected = 1 / (pixels**2 + LOW_PASS)
    # float32 rounds 2^-24 relative per operation
    torch.testing.assert_close(
        projection.conics.cpu(), torch.tensor([[expected, 0.0, expected]]), rtol=1e-6, atol=0.0
    )
    spread = 2 * math.pi * float(projection.opacities) / float(projection.conics[0, 0])
    assert spread == pytest.approx(2 * math.pi * 0.8 * pixels**2, rel=1e-5)


@pytest.mark.parametrize("scales", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.1)])
def test_what_has_no_area_is_not_seen(device, scales):
    camera = Camera(torch.eye(4, device=device), 50.0, 50.0, 16.0, 16.0, 32, 32)
    values = [[0.0, 0, 1]], [[1.0, 0, 0, 0]], [scales], [1.0]
    inputs = [torch.tensor(value, device=device, requires_grad=True) for value in values]
    projection = project(*inputs, camera)
    assert not projection.visible.any()
    gradients = torch.autograd.grad(sum(result.sum() for result in projection[:4]), inputs)
    assert all((gradient == 0).all() for gradient in gradients)


def test_visible_means_an_alpha_in_the_image(device, generator):
    """Over random scenes: whoever reaches ALPHA_MIN at a pixel centre is visible."""
    camera = make_camera(device, width=24, height=18)
    gaussians = make_gaussians(generator, device, count=4000, spread=0.3)
    everywhere = Camera(
        camera.world_to_camera, camera.fx, camera.fy, camera.cx + 1000, camera.cy + 1000, 2024, 2018
    )
    wide = project(*(tensor.double().float() for tensor in gaussians), everywhere)
    y, x = torch.meshgrid(torch.arange(18), torch.arange(24), indexing="ij")
    pixels = torch.stack([x.flatten(), y.flatten()], dim=-1).to(device).double() + 1000.5
    sigma = least_sigma(
        wide.means2d.double()[:, None],
        wide.conics.double()[:, None],
        torch.cat([pixels, pixels], dim=-1)[None],
    )
    # slopes near the border are clamped differently in the wider image: compare where neither clamps, well
    # inside both
    seen = wide.visible & (sigma.amin(dim=1) < torch.log(wide.opacities.double() / ALPHA_MIN) - 1e-2)
    point = gaussians[0] @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    slope = point[:, :2] / point[:, 2:]
    inside = (slope[:, 0].abs() < 0.45 * 24 / camera.fx) & (slope[:, 1].abs() < 0.45 * 18 / camera.fy)
    visible = project(*gaussians, camera).visible
    assert (seen & inside).sum() > 20
    assert visible[seen & inside].all()


def test_no_gaussians(device):
    inputs = [torch.zeros(0, size, device=device, requires_grad=True) for size in (3, 4, 3)]
    projection = project(*inputs, torch.zeros(0, device=device), make_camera(device))
    assert [tuple(result.shape) for result in projection] == [(0, 2), (0,), (0, 3), (0,), (0,)]
    projection.means2d.sum().backward()
    assert inputs[0].grad.shape == (0, 3)


def test_bits_do_not_depend_on_threads_or_runs(generator):
    gaussians, camera = make_gaussians(generator, "cpu", count=5000), make_camera("cpu")
    results = []
    before = torch.get_num_threads()
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        inputs = [tensor.clone().requires_grad_() for tensor in gaussians]
        projection = project(*inputs, camera)
        loss = sum((result * result).sum(dim=0).sum() for result in projection[:4])
        first = torch.autograd.grad(loss, inputs, retain_graph=True)
        results.append((*projection, *first, *torch.autograd.grad(loss, inputs)))
    torch.set_num_threads(before)
    for one, two, again in zip(*results, strict=True):
        assert torch.equal(one, two)
        assert torch.equal(two, again)
    for first, second in zip(results[0][5:9], results[0][9:], strict=True):
        assert torch.equal(first, second)


def test_wrong_shape_is_a_users_error(device):
    zeros = torch.zeros(3, 3, device=device)
    with pytest.raises(UserError, match="quaternions"):
        project(zeros, zeros, zeros, zeros[:, 0], make_camera(device))
