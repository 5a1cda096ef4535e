import math

import pytest
import torch

from samira_warp.kernels.cubemap.layout import (
    face_axes,
    texel_directions,
    texel_index,
    texel_points,
    texel_solid_angles,
)
from samira_warp.kernels.cubemap.lookup import sample_cubemap, sample_mips
from samira_warp.light.equirect import cube_to_equirect, equirect_to_cube
from samira_warp.reference.cubemap import lookup as reference
from samira_warp.support.errors import UserError


def random_directions(count, generator):
    """Directions of any length, a third of them near the cube's edges and corners."""
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    near = torch.sign(directions) * (
        1 + 0.05 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    )
    return torch.where((torch.arange(count) % 3 == 0)[:, None], near, directions)


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_texel_index_inverts_texel_points(size):
    assert torch.equal(texel_index(texel_points(size), size).flatten(), torch.arange(6 * size * size))


@pytest.mark.parametrize("size", [1, 2, 7, 64])
def test_solid_angles_cover_the_sphere(size):
    assert 6 * texel_solid_angles(size, dtype=torch.float64).sum().item() == pytest.approx(
        4 * math.pi, rel=1e-12
    )


def test_solid_angle_is_the_integral_of_the_inverse_cube():
    # dOmega = ds dt / (1 + s^2 + t^2)^(3/2), by midpoints 200 times as fine: error (1/200)^2 of a texel.
    fine = (torch.arange(800, dtype=torch.float64) + 0.5) / 400 - 1
    density = (1 + fine[:, None] ** 2 + fine**2) ** -1.5 * (2 / 800) ** 2
    expected = density.view(4, 200, 4, 200).sum(dim=(1, 3))
    assert torch.allclose(texel_solid_angles(4, dtype=torch.float64), expected, rtol=1e-5)


def test_faces_are_opengls():
    # The OpenGL specification's table, read at s = t = 1/4 of each face: (major, sc, tc).
    expected = torch.tensor(
        [[1, 0.5, 0.5], [-1, 0.5, -0.5], [-0.5, 1, -0.5], [-0.5, -1, 0.5], [-0.5, 0.5, 1], [0.5, 0.5, -1]]
    )
    axes = face_axes().float()
    assert torch.equal(axes[:, 2] - 0.5 * axes[:, 0] - 0.5 * axes[:, 1], expected)


def test_texel_centres_give_the_texels(device, generator):
    cubemap = torch.rand(6, 8, 8, 4, generator=generator).to(device)
    seen = sample_cubemap(cubemap, 3.0 * texel_directions(8, device=device).view(-1, 3))
    # The place in the cell is rounded to 8 texels * 2^-24.
    assert torch.allclose(seen, cubemap.view(-1, 4), atol=2e-6)


@pytest.mark.parametrize("sizes", [(1,), (2,), (5,), (16,), (8, 4, 3, 2, 1)])
@pytest.mark.parametrize("channels", [1, 3])
def test_lookup_matches_the_reference(device, generator, sizes, channels):
    options = {"generator": generator, "dtype": torch.float64}
    mips = [torch.rand(6, size, size, channels, **options).requires_grad_() for size in sizes]
    directions = random_directions(2000, generator).requires_grad_()
    levels = (torch.rand(2000, **options) * (len(sizes) + 1) - 1).requires_grad_()
    upstream = torch.randn(2000, channels, **options)
    expected = reference.sample_mips(tuple(mips), directions, levels)
    expected_grads = torch.autograd.grad(
        expected, [*mips, directions, levels], upstream, materialize_grads=True, allow_unused=True
    )
    inputs = [tensor.detach().float().to(device).requires_grad_() for tensor in [*mips, directions, levels]]
    result = sample_mips(tuple(inputs[:-2]), *inputs[-2:])
    grads = torch.autograd.grad(result, inputs, upstream.float().to(device))
    # A face coordinate is rounded to 2^-24, which is size times as much of a texel.
    assert torch.allclose(result.cpu().double(), expected, atol=16 * 16 * 2**-24)
    for grad, wanted in zip(grads, expected_grads, strict=True):
        assert (grad.cpu() - wanted).norm() <= 1e-5 * wanted.norm()


def test_reference_gradients_are_those_of_finite_differences(generator):
    mips = tuple(
        torch.rand(6, size, size, 2, generator=generator, dtype=torch.float64, requires_grad=True)
        for size in (4, 2)
    )
    directions = random_directions(6, generator).requires_grad_()
    levels = torch.tensor([0.1, 0.4, 0.6, 0.9, -0.5, 1.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda *x: reference.sample_mips(x[:2], *x[2:]), (*mips, directions, levels)
    )


def test_level_gradient_is_one_sided_at_the_ends_and_zero_beyond(device):
    mips = tuple(torch.full((6, 2, 2, 1), value, device=device) for value in (1.0, 3.0, 7.0))
    levels = torch.tensor([-0.1, 0.0, 1.0, 1.5, 2.0, 2.1], device=device, requires_grad=True)
    directions = torch.ones(6, 3, device=device)
    result = sample_mips(mips, directions, levels)
    assert result.flatten().tolist() == pytest.approx([1, 1, 3, 5, 7, 7])
    assert torch.autograd.grad(result.sum(), levels)[0].tolist() == pytest.approx([0, 2, 4, 4, 4, 0])


@pytest.mark.parametrize("size", [1, 2, 8])
def test_values_agree_across_every_seam_and_corner(device, generator, size):
    """Both of a chain's mips at once; each of the 12 edges from its two sides, from corner to corner."""
    mips = tuple(torch.rand(6, s, s, 3, generator=generator).to(device) for s in (size, 4))
    levels = torch.full((41,), 0.3, device=device)
    along = torch.linspace(-1, 1, 41, device=device)
    for axis in range(3):
        for first in (-1.0, 1.0):
            for second in (-1.0, 1.0):
                edge = torch.empty(41, 3, device=device)
                edge[:, axis], edge[:, axis - 1], edge[:, axis - 2] = along, first, second
                one, other = edge.clone(), edge.clone()
                one[:, axis - 1] *= 1 + 1e-5
                other[:, axis - 2] *= 1 + 1e-5
                # 1e-5 of a face is 4e-5 of a texel, on either side, and a texel differs by at most 1 from the
                # next.
                assert torch.allclose(
                    sample_mips(mips, one, levels), sample_mips(mips, other, levels), atol=2e-4
                )


def test_a_corner_is_the_mean_of_its_three_texels(device, generator):
    cubemap = torch.rand(6, 4, 4, 3, generator=generator).to(device)
    corners = torch.tensor([[x, y, z] for x in (-4, 4) for y in (-4, 4) for z in (-4, 4)])
    texels = corners[:, None] - torch.sign(corners)[:, None] * (1 - torch.eye(3, dtype=torch.int64))
    wanted = cubemap.view(-1, 3)[texel_index(texels, 4).to(device)].mean(dim=1)
    assert torch.allclose(sample_cubemap(cubemap, corners.float().to(device)), wanted, atol=1e-6)


def is_adjoint(operator, source, generator):
    """Whether <A x, y> = <x, A' y> to 1e-5 of |A x| |y|, for the linear operator that autograd makes A'
    of."""
    source.requires_grad_()
    result = operator(source)
    upstream = torch.randn(result.shape, generator=generator).to(result)
    (adjoint,) = torch.autograd.grad(result, source, upstream)
    difference = (result.double() * upstream.double()).sum() - (source.double() * adjoint.double()).sum()
    return abs(difference) <= 1e-5 * result.norm().double() * upstream.norm().double()


def test_every_linear_operator_has_its_exact_adjoint(device, generator):
    cubemap = torch.randn(6, 6, 6, 3, generator=generator).to(device)
    directions = random_directions(5000, generator).float().to(device)
    levels = 3 * torch.rand(5000, generator=generator).to(device) - 1
    assert is_adjoint(lambda x: sample_cubemap(x, directions), cubemap, generator)
    chain = torch.randn(6 * (64 + 16), 3, generator=generator).to(device)
    assert is_adjoint(
        lambda x: sample_mips(
            (x[: 6 * 64].view(6, 8, 8, 3), x[6 * 64 :].view(6, 4, 4, 3)), directions, levels
        ),
        chain,
        generator,
    )
    assert is_adjoint(
        lambda x: equirect_to_cube(x, size=8),
        torch.randn(16, 32, 3, generator=generator).to(device),
        generator,
    )
    assert is_adjoint(lambda x: cube_to_equirect(x, height=12), cubemap, generator)


def test_same_bits_for_any_threads_run_and_pass(device, generator, use_threads):
    mips = tuple(
        torch.rand(6, size, size, 3, generator=generator).to(device).requires_grad_() for size in (16, 8)
    )
    directions = random_directions(20000, generator).float().to(device).requires_grad_()
    levels = torch.rand(20000, generator=generator).to(device).requires_grad_()
    upstream = torch.randn(20000, 3, generator=generator).to(device)

    def run():
        result = sample_mips(mips, directions, levels)
        first = torch.autograd.grad(result, [*mips, directions, levels], upstream, retain_graph=True)
        second = torch.autograd.grad(result, [*mips, directions, levels], upstream)
        assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
        return result, *first

    use_threads(1)
    one = run()
    use_threads(2)
    two = run()
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_degenerate_directions(device):
    cubemap = torch.rand(6, 4, 4, 3, device=device, requires_grad=True)
    empty = sample_cubemap(cubemap, torch.empty(0, 3, device=device))
    assert empty.shape == (0, 3)
    assert not torch.autograd.grad(empty.sum(), cubemap)[0].any()
    directions = torch.zeros(1, 3, device=device, requires_grad=True)
    seen = sample_cubemap(cubemap, directions)
    grads = torch.autograd.grad(seen.sum(), [cubemap, directions])
    assert not seen.any()
    assert not any(grad.any() for grad in grads)
    # NaN in one direction stays there.
    directions = torch.tensor([[float("nan"), 0, 1], [0, 0, 1]], device=device)
    assert sample_cubemap(cubemap, directions)[1].isfinite().all()


@pytest.mark.parametrize(
    ("cubemap", "directions"),
    [
        (torch.zeros(5, 4, 4, 3), torch.ones(2, 3)),
        (torch.zeros(6, 4, 3, 3), torch.ones(2, 3)),
        (torch.zeros(6, 4, 4, 3), torch.ones(2, 2)),
    ],
)
def test_wrong_shapes_are_refused(cubemap, directions):
    with pytest.raises(UserError):
        sample_cubemap(cubemap, directions)
