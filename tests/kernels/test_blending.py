import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from samira_warp.kernels.plain import blending as blending_plain
from samira_warp.kernels.raster.blending import blend
from samira_warp.kernels.raster.projection import Projection
from samira_warp.kernels.raster.tiles import bin_tiles
from samira_warp.reference.raster.blending import blend as reference_blend
from samira_warp.support.errors import UserError

WIDTH, HEIGHT = 41, 35


def make_splats(generator, device, count=250, channels=5, aspect=2.0, scale=3.0, opacity=(0.0, 1.0)):
    """Means, conics, opacities, features of ellipses all over and round the image, and their projection in
    random depth order."""
    means2d = (1.4 * torch.rand(count, 2, generator=generator) - 0.2) * torch.tensor([WIDTH, HEIGHT])
    axes = (
        scale
        * torch.exp(0.6 * torch.randn(count, 2, generator=generator))
        * torch.tensor([aspect, 1.0 / aspect])
    )
    angle = math.pi * torch.rand(count, generator=generator)
    R = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], dim=-1).view(-1, 2, 2).double()
    K = torch.linalg.inv(R @ torch.diag_embed(axes.double() ** 2) @ R.mT + 0.3 * torch.eye(2))
    conics = torch.stack([K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]], dim=-1).float()
    opacities = opacity[0] + (opacity[1] - opacity[0]) * torch.rand(count, generator=generator)
    features = torch.randn(count, channels, generator=generator)
    inputs = [tensor.to(device) for tensor in (means2d, conics, opacities, features)]
    depths = torch.rand(count, generator=generator).to(device)
    return inputs, Projection(
        inputs[0], depths, inputs[1], inputs[2], torch.ones_like(depths, dtype=torch.bool)
    )


def make_bins(projection):
    return bin_tiles(projection, width=WIDTH, height=HEIGHT)


def make_weights(generator, device, channels):
    """A random linear functional of both results."""
    shapes = ((HEIGHT, WIDTH, channels), (HEIGHT, WIDTH))
    return [torch.randn(shape, generator=generator).to(device) for shape in shapes]


def with_gradients(function, inputs, weights):
    inputs = [tensor.clone().requires_grad_() for tensor in inputs]
    results = function(*inputs)
    return results, torch.autograd.grad(results, inputs, [weight.to(results[0].dtype) for weight in weights])


def relative(found, expected):
    return ((found.double() - expected).norm() / expected.norm()).item()


@pytest.mark.parametrize("channels", [1, 3, 4, 11, 16, 33])
@pytest.mark.parametrize(
    ("count", "aspect", "scale"), [(250, 2.0, 3.0), (400, 6.0, 4.0), (150, 1.0, 40.0), (400, 1.0, 0.3)]
)
def test_matches_the_dense_twin(device, generator, channels, count, aspect, scale):
    """The twin has no tiles, no rows and no batches: what any cull drops shows."""
    inputs, projection = make_splats(generator, device, count, channels, aspect, scale)
    weights = make_weights(generator, device, channels)
    bins = make_bins(projection)
    size = {"width": WIDTH, "height": HEIGHT}
    found, found_gradients = with_gradients(lambda *tensors: blend(*tensors, bins, **size), inputs, weights)
    order = torch.argsort(projection.depths)
    double = [tensor.double() for tensor in inputs]
    expected, expected_gradients = with_gradients(
        lambda *tensors: reference_blend(*tensors, order, **size), double, weights
    )
    # float32 sigma errs by some 1e-6; where alpha crosses 1/255 or T crosses 1e-4 within that, a pair flips,
    # which changes a pixel by up to 1/255 of a feature (unit normal: below 5): few pixels may, none by more
    for image, truth in zip(found, expected, strict=True):
        error = (image - truth).abs()
        assert (error > 2e-5).float().mean() < 2e-3
        assert error.max() < 5.0 / 255.0 * 2.0
    for gradient, truth in zip(found_gradients, expected_gradients, strict=True):
        # flips of pairs at alpha = 1/255 reach the gradients of faint Gaussians
        assert relative(gradient, truth) < 2e-3
        assert (
            torch.nn.functional.cosine_similarity(gradient.double().flatten(), truth.flatten(), dim=0)
            > 1 - 1e-5
        )


@pytest.mark.parametrize("channels", [3, 11])
def test_matches_the_plain_kernels(generator, channels):
    inputs, projection = make_splats(generator, "cpu", channels=channels)
    weights = make_weights(generator, "cpu", channels)
    bins = make_bins(projection)
    found, gradients = with_gradients(
        lambda *tensors: blend(*tensors, bins, width=WIDTH, height=HEIGHT), inputs, weights
    )
    plain = blending_plain.blend(*inputs, bins, bins.gaussians, width=WIDTH, height=HEIGHT)
    plain_gradients = blending_plain.blend_adjoint(*inputs, bins, bins.gaussians, plain, *weights)
    # two exponentials of 2e-7 relative error; the plain form of sigma is three terms of up to some 300 that
    # cancel, 2e-5 where alpha is a tenth; no pair of this scene lies that close to a threshold
    for one, other in zip(found, plain, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=2e-5)
    for one, other in zip(gradients, plain_gradients, strict=True):
        assert relative(one, other.double()) < 1e-5


def test_gradients_match_finite_differences(device, generator):
    """Five Gaussians by hand, away from every threshold inside the image: no pair within 0.5 % of alpha =
    1/255 or 0.99."""
    means2d = torch.tensor([[12.0, 9.0], [20.3, 15.2], [25.1, 11.7], [16.4, 22.9], [30.2, 26.3]])
    conics = torch.tensor(
        [[4e-3, 1e-3, 5e-3], [3e-3, -1e-3, 2e-3], [2e-3, 0.0, 4e-3], [5e-3, 2e-3, 3e-3], [2e-3, 5e-4, 2e-3]]
    )
    opacities, features = torch.tensor([0.6, 0.5, 0.7, 0.4, 0.8]), torch.randn(5, 3, generator=generator)
    inputs = [tensor.to(device) for tensor in (means2d, conics, opacities, features)]
    projection = Projection(
        inputs[0],
        torch.arange(5, device=device).float() + 1,
        inputs[1],
        inputs[2],
        torch.ones(5, dtype=torch.bool, device=device),
    )
    weights = make_weights(generator, device, 3)
    bins = make_bins(projection)

    def loss(tensors):
        results = blend(*tensors, bins, width=WIDTH, height=HEIGHT)
        return sum(
            (result.double() * weight.double()).sum() for result, weight in zip(results, weights, strict=True)
        )

    _, gradients = with_gradients(
        lambda *tensors: blend(*tensors, bins, width=WIDTH, height=HEIGHT), inputs, weights
    )
    for which, step in enumerate((2e-2, 2e-5, 2e-3, 1e-1)):
        differences = torch.zeros_like(inputs[which])
        for index in range(differences.numel()):
            values = []
            for sign in (1, -1):
                moved = [tensor.clone() for tensor in inputs]
                moved[which].view(-1)[index] += sign * step
                values.append(loss(moved).item())
            differences.view(-1)[index] = (values[0] - values[1]) / (2 * step)
        # central differences: the third derivative's h^2, and float32 rounding of the images (1e-7 x 1e3
        # pixels' worth) over the step
        assert relative(gradients[which], differences.double()) < 5e-3
        assert (
            torch.nn.functional.cosine_similarity(gradients[which].flatten(), differences.flatten(), dim=0)
            > 1 - 1e-4
        )


def test_linear_in_features(device, generator):
    inputs, projection = make_splats(generator, device, channels=7)
    weights = make_weights(generator, device, 7)
    bins = make_bins(projection)
    inputs[3].requires_grad_()
    image = blend(*inputs, bins, width=WIDTH, height=HEIGHT).features
    adjoint = torch.autograd.grad(image, inputs[3], weights[0])[0]
    forward, backward = (
        (image.double() * weights[0].double()).sum(),
        (inputs[3].double() * adjoint.double()).sum(),
    )
    # both sum the same 1e5 products of float32 in another order
    assert abs(forward - backward) < 1e-5 * (image.double() * weights[0].double()).abs().sum()


@pytest.mark.parametrize("count", [1, 63, 64, 65, 300])
def test_opaque_stack_stops(device, count):
    """A pile of wide Gaussians of alpha 0.5: the pixel stops after 13, where T = 2^-13, and the rest weigh
    and get nothing."""
    inputs = [
        torch.tensor([[20.0, 17.0]], device=device).repeat(count, 1),
        torch.tensor([[1e-12, 0.0, 1e-12]], device=device).repeat(count, 1),
        torch.full((count,), 0.5, device=device),
        torch.ones(count, 1, device=device),
    ]
    depths = torch.arange(count, device=device).float()
    seen = torch.ones(count, dtype=torch.bool, device=device)
    bins = make_bins(Projection(inputs[0], depths, inputs[1], inputs[2], seen))
    weights = [torch.ones(HEIGHT, WIDTH, 1, device=device), torch.zeros(HEIGHT, WIDTH, device=device)]
    found, gradients = with_gradients(
        lambda *tensors: blend(*tensors, bins, width=WIDTH, height=HEIGHT), inputs, weights
    )
    shown = min(count, 13)
    torch.testing.assert_close(
        found.transmittance, torch.full_like(found.transmittance, 0.5**shown), rtol=1e-5, atol=0
    )
    torch.testing.assert_close(found.features[..., 0], 1 - found.transmittance, rtol=1e-5, atol=0)
    expected = torch.zeros(count, 1, device=device)
    expected[:shown, 0] = WIDTH * HEIGHT * 0.5 ** torch.arange(1, shown + 1, device=device)
    torch.testing.assert_close(gradients[3], expected, rtol=1e-5, atol=0)
    # sum_k alpha_k prod (1 - alpha_j) = 1 - prod(1 - alpha): d/d alpha_k is the final T over 1 - alpha_k.
    # Front to back it is the difference of T and a sum of order 1 - T, so it errs by float32's 1e-7 per pixel
    expected[:shown, 0] = WIDTH * HEIGHT * 0.5 ** (shown - 1)
    torch.testing.assert_close(gradients[2], expected[:, 0], rtol=1e-5, atol=2e-7 * WIDTH * HEIGHT)


def test_many_gaussians_in_one_tile(generator):
    inputs, projection = make_splats(
        generator, "cpu", count=30000, channels=3, scale=0.2, opacity=(0.004, 0.02)
    )
    inputs[0].mul_(0.3).add_(2.0)
    weights = make_weights(generator, "cpu", 3)
    bins = make_bins(projection)
    assert bins.tile_offsets.diff().max() > 15000
    found, gradients = with_gradients(
        lambda *tensors: blend(*tensors, bins, width=WIDTH, height=HEIGHT), inputs, weights
    )
    plain = blending_plain.blend(*inputs, bins, bins.gaussians, width=WIDTH, height=HEIGHT)
    # 1e3 and more terms per pixel, and alphas of which many lie near 1/255
    assert relative(found.features, plain.features.double()) < 1e-4
    for one, other in zip(
        gradients, blending_plain.blend_adjoint(*inputs, bins, bins.gaussians, plain, *weights), strict=True
    ):
        assert relative(one, other.double()) < 2e-2


def test_full_opacity_is_capped_and_opacity_zero_is_nothing(device):
    means2d = torch.tensor([[8.5, 8.5], [8.5, 8.5]], device=device)
    conics = torch.tensor([[0.1, 0.0, 0.1], [0.1, 0.0, 0.1]], device=device)
    opacities, features = torch.tensor([0.0, 1.0], device=device), torch.tensor([[5.0], [1.0]], device=device)
    projection = Projection(
        means2d,
        torch.tensor([1.0, 2.0], device=device),
        conics,
        opacities,
        torch.ones(2, dtype=torch.bool, device=device),
    )
    weights = [torch.zeros(HEIGHT, WIDTH, 1, device=device), torch.zeros(HEIGHT, WIDTH, device=device)]
    weights[0][8, 8] = 1.0  # the centre, where the cap holds: no gradient but to the feature
    found, gradients = with_gradients(
        lambda *tensors: blend(*tensors, make_bins(projection), width=WIDTH, height=HEIGHT),
        [means2d, conics, opacities, features],
        weights,
    )
    assert found.features[8, 8, 0].item() == pytest.approx(0.99)
    assert gradients[3][:, 0].tolist() == pytest.approx([0.0, 0.99])
    for gradient in gradients[:3]:
        assert (gradient == 0).all()


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_to_blend(device, count):
    inputs = [torch.zeros(count, *shape, device=device) for shape in ((2,), (3,), (), (4,))]
    nothing = torch.zeros(count, dtype=torch.bool, device=device)
    projection = Projection(inputs[0], inputs[2], inputs[1], inputs[2], nothing)
    weights = make_weights(torch.Generator().manual_seed(0), device, 4)
    found, gradients = with_gradients(
        lambda *tensors: blend(*tensors, make_bins(projection), width=WIDTH, height=HEIGHT),
        inputs,
        weights,
    )
    assert (found.features == 0).all()
    assert (found.transmittance == 1).all()
    for gradient, tensor in zip(gradients, inputs, strict=True):
        assert gradient.shape == tensor.shape
        assert (gradient == 0).all()


def test_bits_do_not_depend_on_threads_runs_or_a_second_backward(generator):
    inputs, projection = make_splats(generator, "cpu", count=3000, channels=9)
    weights = make_weights(generator, "cpu", 9)
    before = torch.get_num_threads()
    runs = []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        results = blend(*leaves, make_bins(projection), width=WIDTH, height=HEIGHT)
        first = torch.autograd.grad(results, leaves, weights, retain_graph=True)
        second = torch.autograd.grad(results, leaves, weights)
        assert all(torch.equal(one, two) for one, two in zip(first, second, strict=True))
        runs.append((*results, *first))
    torch.set_num_threads(before)
    for one, two, again in zip(*runs, strict=True):
        assert torch.equal(one, two)
        assert torch.equal(two, again)


def test_wrong_features_are_a_users_error(device, generator):
    inputs, projection = make_splats(generator, device)
    with pytest.raises(UserError, match="features"):
        blend(*inputs[:3], inputs[3][:-1], make_bins(projection), width=WIDTH, height=HEIGHT)


def test_gpu_kernels_match_on_the_cpu():
    """The GPU's kernels run on the CPU with Warp's cooperative blocks, in their own process because the
    switch is global."""
    script = Path(__file__).with_name("compare_blending_sides.py")
    finished = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=300, check=False
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
