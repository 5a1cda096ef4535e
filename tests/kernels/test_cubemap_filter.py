import math

import pytest
import torch

from samira_warp.kernels.cubemap.filter import CHANNELS_MAX, Lobe, _sum_over_texels, irradiance, prefilter
from samira_warp.kernels.cubemap.layout import texel_index, texel_points
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.reference.cubemap import filter as reference
from samira_warp.support.errors import UserError

LADDER = ((0.25, 16), (0.5, 8), (1.0, 8))

QUARTER_TURNS = {
    "x": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "y": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "z": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
}


@pytest.fixture(params=["stored", "made anew"])
def weights(request, monkeypatch):
    """Both ways of a filter: with weights that are kept, as in training, and as for large maps."""
    if request.param == "made anew":
        monkeypatch.setattr("samira_warp.kernels.cubemap.filter._CACHED_WEIGHTS", 0)
    return request.param


@pytest.fixture(params=["one-hot centre", "one-hot corner", "random"])
def radiance(request, generator):
    base = torch.zeros(6, 32, 32, 3, dtype=torch.float64)
    if request.param == "one-hot centre":
        base[2, 15, 16] = 1000.0
    elif request.param == "one-hot corner":
        base[5, 0, 31] = 1000.0
    else:
        base = torch.rand(6, 32, 32, 3, generator=generator, dtype=torch.float64)
    return base


def test_filters_match_brute_force(device, radiance, weights):
    results = (
        prefilter(radiance.float().to(device), ladder=LADDER)[1:],
        (irradiance(radiance.float().to(device)),),
    )
    expected = reference.prefilter(radiance, ladder=LADDER)[1:], (reference.irradiance(radiance),)
    for result, wanted in zip(sum(results, ()), sum(expected, ()), strict=True):
        # 6144 float32 terms: a few ulps of the peak, a hundredth of the 1e-3 that is asked for.
        assert (result.cpu() - wanted).abs().max() <= 1e-5 * wanted.abs().max()


def test_gradients_match_brute_force(device, generator, weights):
    base = torch.rand(6, 16, 16, 2, generator=generator, dtype=torch.float64, requires_grad=True)
    inner = base.detach().float().to(device).requires_grad_()
    ladder = ((0.25, 16), (0.7, 4))
    expected = (*reference.prefilter(base, ladder=ladder)[1:], reference.irradiance(base, size=6))
    results = (*prefilter(inner, ladder=ladder)[1:], irradiance(inner, size=6))
    for result, wanted in zip(results, expected, strict=True):
        upstream = torch.randn(wanted.shape, generator=generator, dtype=torch.float64)
        (grad,) = torch.autograd.grad(result, inner, upstream.float().to(device), retain_graph=True)
        (wanted_grad,) = torch.autograd.grad(wanted, base, upstream)
        assert (grad.cpu() - wanted_grad).norm() <= 1e-5 * wanted_grad.norm()


def test_adjoint(device, generator, weights):
    base = torch.randn(6, 32, 32, 3, generator=generator).to(device).requires_grad_()
    for result in (*prefilter(base, ladder=LADDER)[1:], irradiance(base)):
        upstream = torch.randn(result.shape, generator=generator).to(device)
        (adjoint,) = torch.autograd.grad(result, base, upstream, retain_graph=True)
        forward = (result.double() * upstream.double()).sum()
        assert (
            abs(forward - (base.double() * adjoint.double()).sum()) <= 1e-5 * result.norm() * upstream.norm()
        )


def test_blocks_are_the_whole(device, generator, monkeypatch):
    """A GPU makes the weights of a large filter block by block."""
    base = torch.rand(6, 32, 32, 3, generator=generator).to(device)
    upstream = torch.rand(6, 16, 16, 3, generator=generator).to(device)

    def run():
        inner = base.clone().requires_grad_()
        result = prefilter(inner, ladder=((0.3, 16),))[1]
        return result, torch.autograd.grad(result, inner, upstream)[0]

    whole = run()
    monkeypatch.setattr("samira_warp.kernels.cubemap.filter._CACHED_WEIGHTS", 0)
    monkeypatch.setattr("samira_warp.kernels.cubemap.filter._is_fused", lambda *_: False)
    monkeypatch.setattr("samira_warp.kernels.cubemap.filter._BLOCK_WEIGHTS", 1 << 13)
    monkeypatch.setattr("samira_warp.kernels.cubemap.filter._BLOCK_WIDTH", 100)
    for a, b in zip(whole, run(), strict=True):
        # Sums of 6144 terms in another order.
        assert torch.allclose(a, b, rtol=2e-5, atol=1e-7)


@pytest.mark.parametrize("size", [2, 6, 10])
@pytest.mark.parametrize("channels", [1, 4])
def test_sizes_that_fill_no_vector(device, generator, weights, size, channels):
    base = torch.rand(6, size, size, channels, generator=generator, dtype=torch.float64)
    for result_size in (2, 4, 14):
        (wanted,) = reference.prefilter(base, ladder=((0.6, result_size),))[1:]
        (result,) = prefilter(base.float().to(device), ladder=((0.6, result_size),))[1:]
        assert torch.allclose(result.cpu().double(), wanted, rtol=1e-5)


@pytest.mark.parametrize("size", [16, 64])
def test_white_furnace(device, size, weights):
    white = torch.ones(6, size, size, 1, device=device)
    for mip in prefilter(white, ladder=((0.25, size // 2), (0.5, 8), (0.75, 8), (1.0, 8))):
        assert (mip - 1).abs().max() <= 1e-5
    # Not normalised: midpoints of a cosine that is cut at the horizon, over texels of 90 / size degrees.
    assert (irradiance(white) - 1).abs().max() <= 1e-3


def lobe_integral(roughness):
    """The integral of D max(n . l, 0) over the sphere, with (n . h)^2 = (1 + c) / 2 over c in [0, 1], in
    closed form with q = a + b c."""
    squared = roughness**4
    a, b = (squared + 1) / 2, (squared - 1) / 2
    return 2 * squared * (0.5 if b == 0 else (math.log((a + b) / a) + a / (a + b) - 1) / b**2)


@pytest.mark.parametrize("roughness", [0.25, 0.5, 0.75, 1.0])
def test_weights_sum_to_the_analytic_integral(device, roughness, weights):
    """What a normalised filter's furnace can't see: areas, lobe width and horizon are right before
    normalisation."""
    alpha = roughness * roughness
    reference_sums = reference.lobe_weights(torch.zeros(6, 64, 64, 1, dtype=torch.float64), roughness, 4).sum(
        dim=1
    )
    parts = torch.zeros(8, 6, 6 * 64 * 64 // 8, device=device)
    # The kernels' weights are D / D(1), with D(1) = 1 / (pi alpha^2).
    sums = _sum_over_texels(parts, 64, Lobe(4, alpha, normalised=True))[1].cpu() / (math.pi * alpha**2)
    for found in (reference_sums, sums.double()):
        assert torch.allclose(found, torch.full_like(found, lobe_integral(roughness)), rtol=1e-2)


@pytest.mark.parametrize("axis", QUARTER_TURNS)
def test_quarter_turns_permute_faces(device, generator, weights, axis):
    base = torch.rand(6, 16, 16, 3, generator=generator).to(device)
    turn = torch.tensor(QUARTER_TURNS[axis])

    def turned(cubemap):
        size = cubemap.shape[1]
        places = texel_index(texel_points(size) @ turn.T, size).to(device)
        return cubemap.reshape(-1, 3)[places].view_as(cubemap)

    directions = torch.randn(1000, 3, generator=generator)
    seen = sample_cubemap(turned(base), directions.to(device))
    assert torch.allclose(seen, sample_cubemap(base, (directions @ turn.T.float()).to(device)), atol=1e-5)
    for result, wanted in zip(
        prefilter(turned(base), ladder=LADDER), prefilter(base, ladder=LADDER), strict=True
    ):
        assert torch.allclose(result, turned(wanted), atol=1e-5)
    assert torch.allclose(irradiance(turned(base)), turned(irradiance(base)), atol=1e-5)


def test_same_bits_every_time(device, generator, weights):
    base = torch.rand(6, 32, 32, 3, generator=generator).to(device).requires_grad_()
    upstream = torch.rand(6, 16, 16, 3, generator=generator).to(device)

    def run():
        result = prefilter(base, ladder=((0.25, 16),))[1]
        (first,) = torch.autograd.grad(result, base, upstream, retain_graph=True)
        (second,) = torch.autograd.grad(result, base, upstream)
        assert torch.equal(first, second)
        return result, first

    assert all(torch.equal(a, b) for a, b in zip(run(), run(), strict=True))


def test_a_large_map_has_the_same_bits_for_any_number_of_threads(generator, monkeypatch, use_threads):
    monkeypatch.setattr("samira_warp.kernels.cubemap.filter._CACHED_WEIGHTS", 0)
    base, upstream = (
        torch.rand(6, 32, 32, 3, generator=generator).requires_grad_(),
        torch.rand(6, 16, 16, 3, generator=generator),
    )
    results = []
    for count in (1, 2):
        use_threads(count)
        result = prefilter(base, ladder=((0.25, 16),))[1]
        results.append((result, *torch.autograd.grad(result, base, upstream)))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_as_many_channels_as_there_may_be(generator, weights):
    base = torch.rand(6, 8, 8, CHANNELS_MAX, generator=generator)
    assert torch.allclose(
        irradiance(base, size=4), reference.irradiance(base.double(), size=4).float(), rtol=1e-4
    )


def test_bad_arguments_are_refused():
    with pytest.raises(UserError, match=r"at most 32 channels, found 33"):
        irradiance(torch.zeros(6, 8, 8, 33))
    with pytest.raises(UserError, match="even"):
        irradiance(torch.zeros(6, 8, 8, 3), size=5)
    with pytest.raises(UserError, match="even"):
        irradiance(torch.zeros(6, 7, 7, 3))
    with pytest.raises(UserError, match="roughness"):
        prefilter(torch.zeros(6, 8, 8, 3), ladder=((0.0, 8),))
