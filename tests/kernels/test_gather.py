import pytest
import torch

from samira_warp.kernels.gathering.gather import GatherTable, bilinear_table, gather
from samira_warp.reference.gathering.gather import gather as reference
from samira_warp.support.errors import UserError


def make_table(generator, device, rows=5000, entries=3, sources=700):
    """Random entries; a tenth of them have weight 0, and the last sources are used by no row."""
    indices = torch.randint(sources - 5, (rows, entries), generator=generator)
    weights = torch.randn(rows, entries, generator=generator)
    weights[torch.rand(rows, entries, generator=generator) < 0.1] = 0
    return GatherTable.build(indices.to(device), weights.to(device), sources=sources)


@pytest.mark.parametrize("entries", [1, 3, 4])
@pytest.mark.parametrize("channels", [1, 3, 19])
def test_matches_the_twin_and_its_gradient(device, generator, entries, channels):
    table = make_table(generator, device, entries=entries)
    values = torch.randn(table.sources, channels, generator=generator).to(device).requires_grad_()
    weights = torch.randn(table.rows, channels, generator=generator).to(device)
    exact = values.detach().double().requires_grad_()
    found, expected = gather(values, table), reference(exact, table)
    (grad,), (exact_grad,) = (
        torch.autograd.grad(found, values, weights),
        torch.autograd.grad(expected, exact, weights.double()),
    )
    # A sum of up to 4 terms of up to about 16, each rounded by 2^-24; about 30 of them in a source's
    # gradient.
    assert torch.allclose(found.double(), expected, rtol=0, atol=1e-5)
    assert torch.allclose(grad.double(), exact_grad, rtol=0, atol=1e-4)
    assert (grad.double() - exact_grad).norm() < 1e-6 * exact_grad.norm()


def test_adjoint_dot_product(device, generator):
    table = make_table(generator, device)
    x = torch.randn(table.sources, 7, generator=generator).to(device).requires_grad_()
    y = torch.randn(table.rows, 7, generator=generator).to(device)
    ax = gather(x, table)
    (aty,) = torch.autograd.grad(ax, x, y)
    # Relative to the norms' product, not to the dot product, which cancels.
    difference = (ax.detach().double() * y.double()).sum() - (x.detach().double() * aty.double()).sum()
    assert abs(difference) < 1e-6 * ax.norm() * y.norm()


def test_twin_by_finite_differences(generator):
    table = make_table(generator, "cpu", rows=9, sources=12)
    values = torch.randn(12, 2, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda values: reference(values, table), values)


def test_entries_of_weight_zero_may_point_at_anything(device):
    indices, weights = torch.tensor([[0, 1], [1, 1]]), torch.tensor([[2.0, 0.0], [0.0, 0.0]])
    table = GatherTable.build(indices.to(device), weights.to(device), sources=2)
    values = torch.tensor([[1.0], [torch.nan]], device=device, requires_grad=True)
    result = gather(values, table)
    assert result.tolist() == [[2.0], [0.0]]
    assert reference(values, table).tolist() == [[2.0], [0.0]]
    (grad,) = torch.autograd.grad(result, values, torch.tensor([[3.0], [torch.nan]], device=device))
    assert grad.tolist() == [[6.0], [0.0]]


def test_strided_values_and_gradients(device, generator):
    table = make_table(generator, device, sources=700)
    values = torch.randn(3, 700, generator=generator).to(device)
    weights = torch.randn(3, table.rows, generator=generator).to(device)
    strided, packed = values.T.requires_grad_(), values.T.contiguous().requires_grad_()
    one, two = gather(strided, table), gather(packed, table)
    assert torch.equal(one, two)
    assert torch.equal(
        torch.autograd.grad(one, strided, weights.T)[0],
        torch.autograd.grad(two, packed, weights.T.contiguous())[0],
    )


def test_same_bits_for_any_threads_and_runs(device, generator):
    table = make_table(generator, device, rows=30000)  # 90,000 values: more than ten grains
    values = torch.randn(table.sources, 3, generator=generator).to(device).requires_grad_()
    weights = torch.randn(table.rows, 3, generator=generator).to(device)
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        result = gather(values, table)
        (first,) = torch.autograd.grad(result, values, weights, retain_graph=True)
        (second,) = torch.autograd.grad(result, values, weights)
        assert torch.equal(first, second)
        runs.append((result, first))
    torch.set_num_threads(before)
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


@pytest.mark.parametrize(("rows", "entries", "channels"), [(0, 3, 2), (4, 0, 2), (4, 3, 0)])
def test_nothing_to_gather(device, rows, entries, channels):
    table = GatherTable.build(
        torch.zeros(rows, entries, dtype=torch.int64, device=device),
        torch.ones(rows, entries, device=device),
        sources=5,
    )
    values = torch.ones(5, channels, device=device, requires_grad=True)
    result = gather(values, table)
    assert result.shape == (rows, channels)
    (grad,) = torch.autograd.grad(result.sum(), values)
    assert grad.shape == values.shape
    assert bool((result == 0).all())
    assert bool((grad == 0).all())


@pytest.mark.parametrize(("width", "height"), [(7, 5), (16, 16), (1, 1), (1, 4)])
def test_bilinear_table_is_grid_sample(device, generator, width, height):
    """Torch samples with align_corners=False and its border held; its y points down."""
    image = torch.randn(height, width, 3, generator=generator)
    uv = 1.4 * torch.rand(500, 2, generator=generator, dtype=torch.float64) - 0.2
    grid = torch.stack([2 * uv[:, 0] - 1, 1 - 2 * uv[:, 1]], dim=1)[None, None]
    expected = torch.nn.functional.grid_sample(
        image.double().permute(2, 0, 1)[None],
        grid,
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )[0, :, 0].T
    table = bilinear_table(uv.float().to(device), width=width, height=height)
    found = gather(image.view(-1, 3).to(device), table)
    # The place in a texel is known to 16 texels * 2^-24, times a step between texels of up to about 6.
    assert torch.allclose(found.double().cpu(), expected, rtol=0, atol=2e-5)
    assert torch.allclose(table.weights.sum(dim=1), torch.ones(500, device=device), rtol=0, atol=1e-6)


def test_texel_centres_give_the_texels(device):
    width, height = 6, 4
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    uv = torch.stack([(column + 0.5) / width, 1 - (row + 0.5) / height], dim=-1).view(-1, 2).to(device)
    values = torch.arange(24.0, device=device)[:, None]
    assert torch.allclose(
        gather(values, bilinear_table(uv, width=width, height=height)), values, rtol=0, atol=1e-5
    )


def test_wrong_arguments_are_a_users_error(device):
    indices, weights = torch.zeros(2, 3, dtype=torch.int64, device=device), torch.ones(2, 3, device=device)
    with pytest.raises(UserError, match="0 to 3"):
        GatherTable.build(indices + 4, weights, sources=4)
    with pytest.raises(UserError, match="indices"):
        GatherTable.build(indices - 1, weights, sources=4)
    with pytest.raises(UserError, match="weights"):
        GatherTable.build(indices, weights[:, :2], sources=4)
    with pytest.raises(UserError, match="values"):
        gather(torch.zeros(5, 3, device=device), GatherTable.build(indices, weights, sources=4))
    with pytest.raises(UserError, match="uv"):
        bilinear_table(torch.tensor([[0.5, torch.nan]], device=device), width=4, height=4)
