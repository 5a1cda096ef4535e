import pytest
import torch

from samira_warp.kernels.mesh.uv_raster import TILE, rasterize_uv
from samira_warp.reference.mesh.uv_raster import rasterize_uv as reference
from samira_warp.support.errors import UserError

CORNERS = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]


def centres(size, dtype=torch.float64):
    """(H, W, 2) (u, v) of the texels' centres, row 0 at the top."""
    steps = (torch.arange(size, dtype=dtype) + 0.5) / size
    v, u = torch.meshgrid(1 - steps, steps, indexing="ij")
    return torch.stack([u, v], dim=-1)


def points_of(raster, vt, ft):
    """(H, W, 2) where each texel's weights place it."""
    corners = vt.double()[ft.long()][raster.face.clamp(min=0).long()]
    return (raster.barycentrics.double()[..., None] * corners).sum(dim=2)


def make_soup(generator, device, faces=60, spread=0.15):
    """Triangles of both orientations all over and round the map, many on top of each other."""
    centre = 1.2 * torch.rand(faces, 1, 2, generator=generator) - 0.1
    vt = (centre + spread * torch.randn(faces, 3, 2, generator=generator)).view(-1, 2)
    return vt.to(device), torch.arange(3 * faces).view(-1, 3).to(device)


def make_grid(generator, cells=9):
    """A jittered triangulation of the whole square, its diagonals either way."""
    steps = torch.linspace(0, 1, cells + 1)
    vt = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1)
    vt[1:-1, 1:-1] += 0.3 / cells * (2 * torch.rand(cells - 1, cells - 1, 2, generator=generator) - 1)
    ids = torch.arange((cells + 1) ** 2).view(cells + 1, cells + 1)
    a, b, c, d = (
        ids[:-1, :-1].flatten(),
        ids[:-1, 1:].flatten(),
        ids[1:, 1:].flatten(),
        ids[1:, :-1].flatten(),
    )
    flip = torch.rand(len(a), generator=generator) < 0.5
    one = torch.where(flip[:, None], torch.stack([a, b, d], 1), torch.stack([a, b, c], 1))
    two = torch.where(flip[:, None], torch.stack([b, c, d], 1), torch.stack([a, c, d], 1))
    return vt.view(-1, 2), torch.cat([one, two])


@pytest.mark.parametrize("size", [1, 7, TILE, 3 * TILE + 5, 64])
@pytest.mark.parametrize("spread", [0.01, 0.15, 1.0])
def test_matches_the_twin(device, generator, size, spread):
    vt, ft = make_soup(generator, device, spread=spread)
    found, expected = rasterize_uv(vt, ft, size=size), reference(vt.double(), ft, size=size)
    same = found.face == expected.face
    # A texel whose centre an edge crosses to within 2^-24 may fall either way.
    assert same.float().mean() >= 1 - 2 / size**2 or bool(same.all())
    # Areas to 1e-6 of a texel's square, over slivers' areas: most triangles are large.
    difference = (found.barycentrics.double() - expected.barycentrics)[same].abs()
    assert difference.mean() < 1e-5
    placed = (points_of(found, vt, ft).cpu() - centres(size))[(found.face >= 0).cpu()]
    assert placed.numel() == 0 or placed.norm(dim=-1).max() < 1e-3 / size


def test_a_square_of_two_triangles(device):
    """The lower right triangle, then the upper left one; the diagonal's texels go to the first."""
    ft = torch.tensor([[0, 1, 2], [0, 2, 3]], device=device)
    raster = rasterize_uv(torch.tensor(CORNERS, device=device), ft, size=8)
    uv = centres(8)
    expected = torch.where(uv[..., 1] <= uv[..., 0], 0, 1)
    assert torch.equal(raster.face.cpu().long(), expected)
    # In triangle (0, 0), (1, 0), (1, 1) the weights are 1 - u, u - v, v.
    u, v = uv.unbind(dim=-1)
    weights = torch.stack([1 - u, u - v, v], dim=-1)[expected == 0]
    assert torch.allclose(raster.barycentrics.cpu().double()[expected == 0], weights, rtol=0, atol=1e-6)


def test_v_points_up_and_u_to_the_right(device):
    """A triangle in the corner of large u and large v covers the last column of row 0."""
    vt = torch.tensor([[1.0, 1.0], [0.7, 1.0], [1.0, 0.7]], device=device)
    face = rasterize_uv(vt, torch.tensor([[0, 1, 2]], device=device), size=10).face
    assert face[0, 9] == 0
    assert (face >= 0).nonzero().tolist() == [[0, 7], [0, 8], [0, 9], [1, 8], [1, 9], [2, 9]]


def test_mirrored_faces_count_like_any_other(device, generator):
    vt, ft = make_soup(generator, device)
    straight = rasterize_uv(vt, ft, size=40)
    mirrored = rasterize_uv(vt, ft[:, [0, 2, 1]], size=40)
    assert torch.equal(mirrored.face, straight.face)
    assert torch.allclose(mirrored.barycentrics, straight.barycentrics[..., [0, 2, 1]], rtol=0, atol=1e-4)


def test_lowest_face_wins_overlaps(device, generator):
    vt, ft = make_soup(generator, device, faces=30, spread=0.4)
    single = torch.stack([rasterize_uv(vt, face[None], size=33).face for face in ft]) >= 0
    assert single.sum(dim=0).max() > 3, "the case has overlaps"
    expected = torch.where(single.any(dim=0), single.int().argmax(dim=0), -1)
    assert torch.equal(rasterize_uv(vt, ft, size=33).face.long(), expected)


@pytest.mark.parametrize("size", [17, 45, 128])
def test_shared_edges_leave_no_gap(device, generator, size):
    vt, ft = make_grid(generator)
    raster = rasterize_uv(vt.to(device), ft.to(device), size=size)
    assert bool((raster.face >= 0).all())
    assert torch.allclose(
        raster.barycentrics.sum(dim=-1), torch.ones(size, size, device=device), rtol=0, atol=1e-5
    )
    assert bool((raster.barycentrics >= 0).all())


def test_vertices_and_edges_on_texel_centres_leave_no_gap(device):
    """Every vertex at a texel's centre: ties everywhere, and the lowest of the faces that meet there takes
    it."""
    size, cells = 16, 5
    at = (torch.arange(cells + 1) * 3 + 0.5) / size
    vt = torch.stack(torch.meshgrid(at, 1 - at, indexing="xy"), dim=-1).view(-1, 2)
    ids = torch.arange((cells + 1) ** 2).view(cells + 1, cells + 1)
    a, b, c, d = (
        ids[:-1, :-1].flatten(),
        ids[:-1, 1:].flatten(),
        ids[1:, 1:].flatten(),
        ids[1:, :-1].flatten(),
    )
    ft = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)])
    raster = rasterize_uv(vt.to(device), ft.to(device), size=size)
    assert torch.equal(raster.face.cpu(), reference(vt.double(), ft, size=size).face)
    assert bool((raster.face >= 0).all())


def test_what_lies_outside_is_cut_off(device):
    """A face far larger than the map covers all of it, and one beside it nothing."""
    vt = torch.tensor(
        [[-5.0, -5.0], [20.0, -5.0], [-5.0, 20.0], [1.5, 0.0], [2.5, 0.0], [1.5, 1.0]], device=device
    )
    ft = torch.tensor([[3, 4, 5], [0, 1, 2]], device=device)
    raster = rasterize_uv(vt, ft, size=37)
    assert bool((raster.face == 1).all())
    assert (points_of(raster, vt, ft).cpu() - centres(37)).abs().max() < 1e-5


def test_degenerate_faces_cover_nothing(device):
    vt = torch.tensor([[0.5, 0.5], [0.25, 0.25], [0.75, 0.75], *CORNERS], device=device)
    degenerate = [[0, 0, 0], [0, 1, 2], [0, 0, 1]]
    assert bool((rasterize_uv(vt, torch.tensor(degenerate, device=device), size=8).face == -1).all())
    raster = rasterize_uv(vt, torch.tensor([*degenerate, [3, 4, 5], [3, 5, 6]], device=device), size=8)
    assert set(raster.face.unique().tolist()) == {3, 4}
    assert bool(raster.barycentrics.isfinite().all())


def test_no_faces(device):
    raster = rasterize_uv(
        torch.zeros(4, 2, device=device), torch.empty(0, 3, dtype=torch.int64, device=device), size=20
    )
    assert bool((raster.face == -1).all())
    assert not raster.barycentrics.any()


def test_same_bits_for_any_threads_and_runs(device, generator):
    vt, ft = make_soup(generator, device, faces=200)
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        runs.append(rasterize_uv(vt, ft, size=96))
    torch.set_num_threads(before)
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


def test_wrong_arguments_are_a_users_error(device):
    faces = torch.tensor([[0, 1, 2]], device=device)
    with pytest.raises(UserError, match="vt"):
        rasterize_uv(torch.zeros(3, 3, device=device), faces, size=4)
    with pytest.raises(UserError, match="ft"):
        rasterize_uv(torch.zeros(3, 2, device=device), faces[:, :2], size=4)
