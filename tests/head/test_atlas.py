from dataclasses import replace

import numpy as np
import pytest
import torch
from data.tiny import tiny_template
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from samira_warp.head.atlas import DILATION, SOFTENING, UvAtlas
from samira_warp.head.regions import REGIONS, response_coverage, route_faces
from samira_warp.head.template import read_template
from samira_warp.kernels.mesh.uv_raster import rasterize_uv

SIZE = 48


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """The made-up head, its scalp in no mask: those texels respond neutrally."""
    path = tmp_path_factory.mktemp("head") / "head.npz"
    np.savez(path, **tiny_template())
    template = read_template(path)
    return replace(template, masks={name: ids for name, ids in template.masks.items() if name != "scalp"})


@pytest.fixture(scope="module")
def atlas(template):
    return UvAtlas.build(template, size=SIZE)


@pytest.fixture(scope="module")
def raster(template):
    """Which face covers each texel's centre, and where in the face it lies."""
    return rasterize_uv(torch.from_numpy(template.vt), torch.from_numpy(template.ft), size=SIZE)


@pytest.fixture(scope="module")
def covered(raster):
    """(H, W) bool: texels whose centre a face covers."""
    return raster.face >= 0


@pytest.fixture(scope="module")
def nearest(atlas):
    """(H, W) long: the flat index of the texel that each valid texel copies, as `dilate` tells it."""
    own = torch.arange(SIZE * SIZE, dtype=torch.float32).view(SIZE, SIZE, 1)
    return atlas.dilate(own)[..., 0].long()


def covering_faces(raster, nearest):
    """(H, W) face of each texel or of the texel it copies."""
    return raster.face.flatten()[nearest].long()


def charts_of_faces(template):
    """(F,) chart labels by scipy: components of the graph of UV coordinates that share a face."""
    rows, columns = template.ft.flatten(), template.ft[:, [1, 2, 0]].flatten()
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(template.vt),) * 2)
    return torch.from_numpy(connected_components(graph, directed=False)[1][template.ft[:, 0]])


def test_dilation_copies_the_nearest_covered_texel(atlas, covered, nearest):
    """By brute force over all pairs: valid is what lies within 2 rows and columns of a covered texel."""
    texels = torch.stack(torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij"), dim=-1).view(
        -1, 2
    )
    assert 0.5 < covered.float().mean() < 0.95
    sources = texels[covered.flatten()]
    steps = (texels[:, None] - sources[None]).abs()
    assert torch.equal(atlas.valid.flatten(), (steps.amax(dim=2) <= DILATION).any(dim=1))
    valid = atlas.valid.flatten()
    squared = (steps**2).sum(dim=2).amin(dim=1)
    copied = texels[nearest.flatten()]
    assert torch.equal(((copied - texels) ** 2).sum(dim=1)[valid], squared[valid])
    assert bool(covered.flatten()[nearest.flatten()[valid]].all())
    assert torch.equal(copied[covered.flatten()], sources)


def test_dilate_maps(device, atlas, nearest, generator):
    uv_map = torch.randn(SIZE, SIZE, 5, generator=generator)
    expected = uv_map.view(-1, 5)[nearest] * atlas.valid[..., None]
    assert torch.equal(atlas.to(device).dilate(uv_map.to(device)).cpu(), expected)


def test_positions_are_interpolated_vertices(device, template, atlas, raster, nearest):
    vertices = torch.from_numpy(template.v_template)
    positions = atlas.to(device).positions(vertices.to(device)).cpu()
    faces = covering_faces(raster, nearest)
    weights = raster.barycentrics.view(-1, 3)[nearest].double()
    expected = (weights[..., None] * vertices.double()[torch.from_numpy(template.faces)[faces].long()]).sum(
        dim=2
    )
    assert torch.allclose(
        positions.double()[atlas.valid], expected[atlas.valid], rtol=0, atol=2e-8
    )  # 0.1 m times 2^-24, a few times over
    assert not positions[~atlas.valid].any()


def test_positions_follow_affine_motion(atlas, template, generator):
    vertices = torch.from_numpy(template.v_template)
    matrix, shift = torch.randn(3, 3, generator=generator), torch.randn(3, generator=generator)
    moved = atlas.positions(vertices @ matrix.T + shift)
    expected = (atlas.positions(vertices) @ matrix.T + shift) * atlas.valid[..., None]
    assert torch.allclose(moved, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", ["positions", "dilate"])
def test_adjoint_dot_product(device, atlas, template, generator, name):
    shape = (len(template.v_template), 3) if name == "positions" else (SIZE, SIZE, 3)
    x = torch.randn(shape, generator=generator).to(device).requires_grad_()
    ax = getattr(atlas.to(device), name)(x)
    y = torch.randn(ax.shape, generator=generator).to(device)
    (aty,) = torch.autograd.grad(ax, x, y)
    difference = (ax.detach().double() * y.double()).sum() - (x.detach().double() * aty.double()).sum()
    assert abs(difference) < 1e-6 * ax.norm() * y.norm()


def test_positions_of_what_is_not_valid_do_not_spoil_the_gradient(atlas, template):
    """NaN upstream in empty texels arrives at no vertex."""
    vertices = torch.from_numpy(template.v_template).clone().requires_grad_()
    weight = torch.where(atlas.valid, 1.0, torch.nan)[..., None].expand(SIZE, SIZE, 3)
    (grad,) = torch.autograd.grad(atlas.positions(vertices), vertices, weight)
    assert bool(grad.isfinite().all())
    # Weights sum to 1 in each valid texel.
    assert grad.sum().item() == pytest.approx(3 * atlas.valid.sum().item(), rel=1e-5)


def test_regions_are_the_faces(template, atlas, raster, nearest):
    expected = torch.where(
        atlas.valid, torch.from_numpy(route_faces(template))[covering_faces(raster, nearest)], -1
    )
    assert torch.equal(atlas.region.long(), expected)
    assert atlas.region.dtype == torch.int8
    assert len(atlas.region.unique()) > 7


def test_soft_masks_by_brute_force(template, atlas, raster, nearest):
    """Shares of the regions within a cone of 3 texels, in the texel's own chart, texel by texel."""
    faces = covering_faces(raster, nearest)
    chart = charts_of_faces(template)[faces]
    responds = torch.from_numpy(response_coverage(template))[faces] & atlas.valid
    assert not torch.equal(responds, atlas.valid), "the case has texels without a mask"
    assert len(chart[atlas.valid].unique()) == 3
    region, chart, responds = atlas.region.tolist(), chart.tolist(), responds.tolist()
    expected = np.zeros((len(REGIONS), SIZE, SIZE))
    reach = range(-SOFTENING, SOFTENING + 1)
    steps = [
        (i, j, 1 - np.hypot(i, j) / (SOFTENING + 1))
        for i in reach
        for j in reach
        if np.hypot(i, j) <= SOFTENING + 1
    ]
    for row, column in zip(*np.nonzero(np.array(responds)), strict=True):
        for i, j, weight in steps:
            y, x = row + i, column + j
            if 0 <= y < SIZE and 0 <= x < SIZE and responds[y][x] and chart[y][x] == chart[row][column]:
                expected[region[y][x], row, column] += weight
    expected /= np.maximum(expected.sum(axis=0), 1e-8)
    assert np.abs(atlas.soft_masks.double().numpy() - expected).max() < 1e-6


def test_soft_masks_share_out_what_responds(template, atlas, raster, nearest):
    responds = torch.from_numpy(response_coverage(template))[covering_faces(raster, nearest)] & atlas.valid
    total = atlas.soft_masks.sum(dim=0)
    assert torch.allclose(total[responds], torch.ones(int(responds.sum())), rtol=0, atol=1e-6)
    assert not atlas.soft_masks[:, ~responds].any()
    assert bool((atlas.soft_masks >= 0).all())
    assert not atlas.soft_masks[REGIONS.index("scalp")].any(), "no mask, no response"
    # The texel itself weighs most; where a region fades into another both have a part.
    assert bool(((atlas.soft_masks > 0).sum(dim=0) > 1).any())


def test_without_masks_nothing_responds(template):
    atlas = UvAtlas.build(replace(template, masks={}), size=16)
    assert not atlas.soft_masks.any()
    assert set(atlas.region[atlas.valid].tolist()) == {REGIONS.index("cheeks")}
    assert bool((atlas.region[~atlas.valid] == -1).all())


def test_uv_of_a_texels_face_and_weights_is_its_centre(device, atlas, raster, covered):
    row, column = covered.nonzero().unbind(dim=1)
    found = (
        atlas.to(device)
        .uv_of(raster.face[row, column].to(device), raster.barycentrics[row, column].to(device))
        .cpu()
    )
    expected = torch.stack([(column + 0.5) / SIZE, 1 - (row + 0.5) / SIZE], dim=1)
    # Weights are areas over an area, of faces of a few texels: some 2^-24 * 48 texels.
    assert torch.allclose(found, expected, rtol=0, atol=2e-5)


def test_uv_of_corners(atlas, template):
    faces = torch.arange(len(template.ft))
    for corner in range(3):
        found = atlas.uv_of(faces, torch.eye(3)[corner].expand(len(faces), 3))
        assert torch.equal(found, torch.from_numpy(template.vt[template.ft[:, corner]]))


def test_to_moves_every_tensor(device, atlas):
    moved = atlas.to(device)
    tensors = [value for value in vars(moved).values() if isinstance(value, Tensor)]
    tensors += [
        value
        for table in (moved.position_table, moved.dilation_table)
        for value in vars(table).values()
        if torch.is_tensor(value)
    ]
    assert len(tensors) == 5 + 2 * 5
    assert all(tensor.device.type == device.type for tensor in tensors)


def test_two_builds_are_equal(template, atlas):
    again = UvAtlas.build(template, size=SIZE)
    assert all(
        torch.equal(value, getattr(again, name))
        for name, value in vars(atlas).items()
        if isinstance(value, Tensor)
    )


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 17])
def test_any_size(template, size):
    atlas = UvAtlas.build(template, size=size)
    assert atlas.soft_masks.shape == (len(REGIONS), size, size)
    assert atlas.positions(torch.from_numpy(template.v_template)).shape == (size, size, 3)


@pytest.mark.subject
def test_the_real_heads_atlas(subject):
    template = read_template(subject / "template.npz")
    atlas = UvAtlas.build(template, size=128)
    covered = rasterize_uv(atlas.vt, atlas.ft, size=128).face >= 0
    assert set(atlas.region[covered].tolist()) == set(range(10))
    vertices = torch.from_numpy(template.v_template)
    positions = atlas.positions(vertices)[atlas.valid]
    assert bool((positions >= vertices.amin(dim=0) - 1e-6).all())
    assert bool((positions <= vertices.amax(dim=0) + 1e-6).all())
    # Left is +x: the face looks along +z, y up.
    for name, sign in (("left_eye", 1), ("right_eye", -1)):
        assert bool((sign * positions[atlas.region[atlas.valid] == REGIONS.index(name), 0] > 0).all())
