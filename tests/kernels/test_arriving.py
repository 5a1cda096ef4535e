"""What arrives of a light past a mesh: sums over directions against their twin, and what is exact in them."""

import pytest
import torch

from samira_warp.kernels.rays import arriving
from samira_warp.kernels.rays.arriving import arriving_irradiance, open_shares
from samira_warp.kernels.runtime import launch_range
from samira_warp.reference.rays import arriving as reference

EDGES = torch.tensor([0.9, 0.2, -0.5])


def unit(values):
    return torch.nn.functional.normalize(values, dim=-1)


@pytest.fixture
def case(generator):
    """Float64 inputs: points of which some see all, some nothing, and some a half of 96 directions."""
    bits = torch.randint(-(2**31), 2**31, (50, 3), generator=generator).to(torch.int32)
    bits[::5] = -1
    bits[1::5] = 0
    options = {"generator": generator, "dtype": torch.float64}
    normals, directions = (unit(torch.randn(count, 3, **options)) for count in (50, 96))
    return bits, normals, directions, torch.rand(96, 3, **options) ** 4


def test_sums_and_their_adjoint_match_the_twin(case, device, generator):
    bits, normals, directions, powers = case
    upstream = [torch.randn(50, 3, generator=generator, dtype=torch.float64) for _ in range(2)]
    exact = powers.clone().requires_grad_()
    expected = reference.arriving_irradiance(bits, normals, directions, exact)
    expected_grad = torch.autograd.grad(expected, exact, upstream)[0]
    single = [values.float().to(device) for values in (normals, directions, powers)]
    single[2].requires_grad_()
    found = arriving_irradiance(bits.to(device), *single)
    grad = torch.autograd.grad(found, single[2], [values.float().to(device) for values in upstream])[0]
    # sums of 96 terms of at most 1, rounded to float32, in inputs that were rounded once: 96 x 6e-8 x 2
    for values, truth in zip(found, expected, strict=True):
        torch.testing.assert_close(values.double().cpu(), truth.detach(), atol=2e-5, rtol=0)
    torch.testing.assert_close(grad.double().cpu(), expected_grad, atol=1e-4, rtol=0)


def test_the_adjoint_is_the_transpose(case, generator):
    """<A p, g> = <p, A' g> for a linear map, to the rounding of float32 sums of some thousand products."""
    bits, normals, directions, powers = case
    single = [values.float() for values in (normals, directions, powers)]
    single[2].requires_grad_()
    found = arriving_irradiance(bits, *single)
    upstream = [torch.randn(50, 3, generator=generator) for _ in found]
    (grad,) = torch.autograd.grad(found, single[2], upstream)
    left = sum(float((a.double() * b.double()).sum()) for a, b in zip(found, upstream, strict=True))
    right = float((single[2].double() * grad.double()).sum())
    scale = sum(float((a * b).abs().sum()) for a, b in zip(found, upstream, strict=True))
    assert abs(left - right) < 1e-6 * scale


def test_where_all_is_open_both_sums_have_the_same_bits(case, device):
    bits, *others = case
    found = arriving_irradiance(bits.to(device), *(values.float().to(device) for values in others))
    assert torch.equal(found.arriving[::5], found.unblocked[::5])
    assert (found.arriving[1::5] == 0).all()
    assert (found.unblocked[1::5] > 0).any()


def test_shares_of_lobes_match_the_twin(case, device, generator):
    bits, axes, directions, _ = case
    areas = torch.rand(96, generator=generator, dtype=torch.float64)
    expected = reference.open_shares(bits, axes, EDGES.double(), directions, areas)
    single = [values.float().to(device) for values in (axes, EDGES, directions, areas)]
    found = open_shares(bits.to(device), *single)
    # cosines are a rounding or two off, which a lobe that few directions are barely within shows most
    torch.testing.assert_close(found.double().cpu(), expected, atol=1e-3, rtol=0)
    assert float((found.double().cpu() - expected).abs().median()) < 1e-6
    assert (found[::5] == 1).all()


def test_a_lobe_without_any_direction_is_open():
    bits, up = torch.zeros(2, 1, dtype=torch.int32), torch.tensor([[0.0, 1.0, 0.0]])
    below = -up.expand(32, 3).contiguous()
    shares = open_shares(bits, up.expand(2, 3), torch.tensor([0.5, -1.0]), below, torch.ones(32))
    assert shares.tolist() == [[1.0, 1.0]] * 2


def test_the_plain_kernels_say_the_same(case):
    """Those that a GPU runs, on the CPU: other orders of sums, as above."""
    bits, normals, directions, powers = (
        values if values.dtype == torch.int32 else values.float() for values in case
    )
    found = arriving_irradiance(bits, normals, directions, powers)
    plain = [torch.empty(50, 3) for _ in range(2)]
    launch_range(arriving._arriving, 50, bits, normals, directions, powers, *plain, grain=16)
    for values, other in zip(found, plain, strict=True):
        torch.testing.assert_close(values, other, atol=2e-5, rtol=0)
    grads = [torch.ones(50, 3), 2 * torch.ones(50, 3)]
    grad = torch.empty(96, 3)
    launch_range(arriving._arriving_adjoint, 96, bits, normals, directions, *grads, grad, grain=16)
    powers.requires_grad_()
    (expected,) = torch.autograd.grad(arriving_irradiance(bits, normals, directions, powers), powers, grads)
    torch.testing.assert_close(grad, expected, atol=1e-4, rtol=0)
    areas, shares = torch.ones(96), torch.empty(50, 3)
    launch_range(arriving._open_shares, 50, bits, normals, EDGES, directions, areas, shares, grain=16)
    torch.testing.assert_close(
        shares, open_shares(bits, normals, EDGES, directions, areas), atol=1e-4, rtol=0
    )


def test_any_number_of_threads_gives_the_same_bits(generator, use_threads):
    bits = torch.randint(-(2**31), 2**31, (2000, 12), generator=generator).to(torch.int32)
    normals, directions = unit(torch.randn(2000, 3, generator=generator)), unit(torch.randn(384, 3))
    powers = torch.rand(384, 3, generator=generator, requires_grad=True)

    def run():
        found = arriving_irradiance(bits, normals, directions, powers)
        (grad,) = torch.autograd.grad(found, powers, [torch.ones(2000, 3)] * 2)
        return (*found, grad, open_shares(bits, normals, EDGES, directions, torch.ones(384)))

    results = []
    for threads in (1, 2):
        use_threads(threads)
        results.append(run())
    assert all(torch.equal(one, two) for one, two in zip(*results, strict=True))
