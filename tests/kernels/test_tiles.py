import math

import pytest
import torch

from samira_warp.kernels.raster.projection import Projection
from samira_warp.kernels.raster.tiles import TILE, bin_tiles
from samira_warp.reference.raster.tiles import bin_tiles as reference_bin_tiles
from samira_warp.support.constants import ALPHA_MIN
from samira_warp.support.errors import UserError


def make_ellipses(generator, device, count=300, width=70, height=50, aspect=1.0, scale=3.0):
    """Ellipses all over and round an image, with log-normal axes (``aspect`` more on one) and every opacity
    from 0 to 1."""
    extent = torch.tensor([width, height]).float()
    means2d = (1.4 * torch.rand(count, 2, generator=generator) - 0.2) * extent
    axes = (
        scale
        * torch.exp(0.6 * torch.randn(count, 2, generator=generator))
        * torch.tensor([aspect, 1.0 / aspect])
    )
    angle = math.pi * torch.rand(count, generator=generator)
    c, s = angle.cos(), angle.sin()
    R = torch.stack([torch.stack([c, -s], dim=-1), torch.stack([s, c], dim=-1)], dim=-2).double()
    K = torch.linalg.inv(R @ torch.diag_embed(axes.double() ** 2) @ R.mT + 0.3 * torch.eye(2))
    conics = torch.stack([K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]], dim=-1).float()
    depths = 0.5 + torch.rand(count, generator=generator)
    opacities = torch.rand(count, generator=generator)
    visible = torch.rand(count, generator=generator) < 0.9
    return Projection(*(tensor.to(device) for tensor in (means2d, depths, conics, opacities, visible)))


def entries(bins):
    """{(tile, Gaussian)} of all entries."""
    tiles = torch.repeat_interleave(
        torch.arange(bins.columns * bins.rows, device=bins.tile_offsets.device),
        bins.tile_offsets.diff().long(),
    )
    return set(zip(tiles.tolist(), bins.gaussians[: len(tiles)].tolist(), strict=True))


def visible_pairs(projection, width, height):
    """{(tile, Gaussian)} with alpha of at least ALPHA_MIN at a pixel centre, by brute force in float64."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([x.flatten(), y.flatten()], dim=-1).to(projection.means2d.device).double() + 0.5
    dx, dy = (pixels[:, None] - projection.means2d.double()).unbind(-1)
    xx, xy, yy = projection.conics.double().unbind(-1)
    alpha = projection.opacities.double() * torch.exp(-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy)
    pixel, gaussian = ((alpha >= ALPHA_MIN) & projection.visible).nonzero(as_tuple=True)
    tile = pixel // width // TILE * -(-width // TILE) + pixel % width // TILE
    return set(zip(tile.tolist(), gaussian.tolist(), strict=True))


@pytest.mark.parametrize(("aspect", "scale"), [(1.0, 0.5), (1.0, 3.0), (4.0, 3.0), (8.0, 6.0), (1.0, 60.0)])
def test_no_visible_pair_is_dropped_and_few_others_kept(device, generator, aspect, scale):
    projection = make_ellipses(generator, device, aspect=aspect, scale=scale)
    bins = bin_tiles(projection, width=70, height=50)
    kept, needed = entries(bins), visible_pairs(projection, 70, 50)
    assert len(needed) > 200
    assert needed <= kept
    # exact against the twin, but for the margin of 1e-3 + 1e-4 sigma on the ellipse
    double = Projection(*(tensor.double() for tensor in projection[:4]), projection.visible)
    exact = entries(reference_bin_tiles(double, width=70, height=50))
    assert exact <= kept
    assert len(kept - exact) <= 0.005 * len(exact) + 1


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16, 16), (17, 5), (64, 33)])
def test_layout(device, generator, width, height):
    projection = make_ellipses(generator, device, width=width, height=height)
    projection.depths[::3] = 0.75  # equal depths keep the order of the input
    bins = bin_tiles(projection, width=width, height=height)
    assert (bins.columns, bins.rows) == (-(-width // TILE), -(-height // TILE))
    assert bins.tile_offsets[0] == 0
    assert bins.tile_offsets[-1] == len(bins.gaussians) == bins.slot_offsets[-1]
    for begin, end in zip(bins.tile_offsets[:-1].tolist(), bins.tile_offsets[1:].tolist(), strict=True):
        inside = bins.gaussians[begin:end].tolist()
        assert inside == sorted(set(inside), key=lambda i: (projection.depths[i].item(), i))
    assert torch.equal(bins.slots.sort().values.cpu(), torch.arange(len(bins.slots), dtype=torch.int32))
    owner = torch.repeat_interleave(bins.order, bins.slot_offsets.diff().long())
    assert torch.equal(owner[bins.slots.long()], bins.gaussians)


def test_capacity_changes_nothing_where_it_suffices_and_drops_the_farthest_where_not(device, generator):
    projection = make_ellipses(generator, device)
    bins = bin_tiles(projection, width=70, height=50)
    count = len(bins.gaussians)
    roomy = bin_tiles(projection, width=70, height=50, capacity=count + 100)
    assert torch.equal(roomy.tile_offsets, bins.tile_offsets)
    assert torch.equal(roomy.gaussians[:count], bins.gaussians)
    assert torch.equal(roomy.slots[:count], bins.slots)
    tight = bin_tiles(projection, width=70, height=50, capacity=count // 2)
    assert tight.tile_offsets[-1] == count // 2
    dropped = entries(bins) - entries(tight)
    assert entries(tight) < entries(bins)
    nearest = min(projection.depths[i].item() for _, i in dropped)
    assert all(projection.depths[i].item() <= nearest for _, i in entries(tight))


@pytest.mark.parametrize("count", [0, 5])
@pytest.mark.parametrize("capacity", [None, 0, 10])
def test_nothing_to_bin(device, count, capacity):
    zeros = [torch.zeros(count, *shape, device=device) for shape in ((2,), (), (3,), ())]
    empty = Projection(*zeros, torch.zeros(count, dtype=torch.bool, device=device))
    bins = bin_tiles(empty, width=20, height=20, capacity=capacity)
    assert bins.tile_offsets.tolist() == [0] * 5
    assert (bins.slot_offsets == 0).all()


def test_hostile_ellipses_end(device):
    """Whatever the conic, means and opacities hold, binning ends without an error and without NaN keeping a
    tile."""
    values = torch.tensor([0.0, 1.0, -1.0, 1e-30, 1e30, math.inf, math.nan], device=device)
    conics = torch.cartesian_prod(values, values, values)
    count = len(conics)
    means2d = torch.stack(
        [values[torch.arange(count, device=device) % 7], torch.full((count,), 5.0, device=device)], dim=-1
    )
    projection = Projection(
        means2d,
        torch.ones(count, device=device),
        conics,
        torch.full((count,), 0.5, device=device),
        torch.ones(count, dtype=torch.bool, device=device),
    )
    bins = bin_tiles(projection, width=64, height=64)
    assert bins.tile_offsets[-1] <= 16 * count
    assert not (torch.isnan(means2d[bins.gaussians.long()])).any()


def test_bits_do_not_depend_on_threads(generator):
    projection = make_ellipses(generator, "cpu", count=20000, width=200, height=100)
    before = torch.get_num_threads()
    results = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        results.append(bin_tiles(projection, width=200, height=100))
    torch.set_num_threads(before)
    for one, two in zip(results[0][:5], results[1][:5], strict=True):
        assert torch.equal(one, two)


def test_wrong_opacities_are_a_users_error(device, generator):
    projection = make_ellipses(generator, device)
    with pytest.raises(UserError, match="opacities"):
        bin_tiles(projection._replace(opacities=projection.opacities[1:]), width=10, height=10)
