import pytest
import torch

from samira_warp.kernels.mesh.barycentric import closest_barycentrics
from samira_warp.reference.mesh.barycentric import closest_barycentrics as reference
from samira_warp.support.errors import UserError

REGIONS = {
    "corner a": "a",
    "corner b": "b",
    "corner c": "c",
    "edge ab": "ab",
    "edge bc": "bc",
    "edge ca": "ca",
    "interior": "abc",
}


def make_triangles(generator, count):
    """(N, 3, 3) float64 triangles, acute and obtuse, none thinner than a tenth of its sides."""
    triangles = torch.randn(20 * count, 3, 3, generator=generator, dtype=torch.float64)
    a, b, c = triangles.unbind(dim=1)
    longest = torch.stack([b - a, c - b, a - c]).norm(dim=2).amax(dim=0)
    height = torch.linalg.cross(b - a, c - a).norm(dim=1) / longest
    return triangles[(height > 0.1 * longest) & (longest > 0.5)][:count]


def points_in_region(triangles, corners, generator):
    """Points whose closest point is known to lie on ``corners``' corner, edge or interior, and that point's
    weights."""
    count, uniform = len(triangles), {"generator": generator, "dtype": torch.float64}
    weights = torch.zeros(count, 3, dtype=torch.float64)
    for corner in corners:
        weights[:, "abc".index(corner)] = 0.1 + torch.rand(count, **uniform)
    weights = weights / weights.sum(dim=1, keepdim=True)
    a, b, c = triangles.unbind(dim=1)
    normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    points = (weights[:, None] @ triangles)[:, 0] + normal * torch.randn(count, 1, **uniform)
    for edge in ("ab", "bc", "ca"):
        if set(corners) <= set(edge):
            start, end = (triangles[:, "abc".index(name)] for name in edge)
            outward = torch.nn.functional.normalize(torch.linalg.cross(end - start, normal), dim=1)
            points = points + outward * (0.05 + torch.rand(count, 1, **uniform))
    return points, weights


def distances(points, triangles, weights):
    return ((weights[:, None] @ triangles)[:, 0] - points).norm(dim=1)


@pytest.mark.parametrize("region", REGIONS)
def test_each_voronoi_region(device, generator, region):
    triangles = make_triangles(generator, 1000)
    points, expected = points_in_region(triangles, REGIONS[region], generator)
    found = closest_barycentrics(points.float().to(device), triangles.float().to(device)).cpu()
    # Products of four lengths of up to 5, to 2^-24, over an area squared of at least (0.5 * 0.05 / 2)^2 in
    # the worst triangle.
    assert torch.allclose(found.double(), expected, rtol=0, atol=2e-3)
    assert (found.double() - expected).abs().mean() < 2e-6
    away = [index for index, corner in enumerate("abc") if corner not in REGIONS[region]]
    assert not found[:, away].any(), "what lies on a corner or an edge has weights of exactly 0"
    assert torch.allclose(reference(points, triangles), expected, rtol=0, atol=1e-9)


def test_nothing_of_the_triangle_is_closer(device, generator):
    """Brute force: 1,326 samples of each triangle, against points all over its seven regions."""
    triangles = make_triangles(generator, 400)
    points = 2 * torch.randn(400, 3, generator=generator, dtype=torch.float64)
    found = closest_barycentrics(points.float().to(device), triangles.float().to(device)).double().cpu()
    steps = 50
    grid = (
        torch.tensor(
            [[i, j, steps - i - j] for i in range(steps + 1) for j in range(steps + 1 - i)],
            dtype=torch.float64,
        )
        / steps
    )
    sampled = torch.cdist(points[:, None], grid @ triangles)[:, 0].amin(dim=1)
    closest = distances(points, triangles, found)
    longest = (triangles - triangles.roll(1, dims=1)).norm(dim=2).amax(dim=1)
    assert bool((closest <= sampled + 1e-5).all())
    assert bool((closest >= sampled - longest / steps).all()), (
        "a sample lies within a step of every point of the triangle"
    )
    assert len((found > 0).int().matmul(torch.tensor([1, 2, 4], dtype=torch.int32)).unique()) == 7


def test_matches_the_twin(device, generator):
    triangles = make_triangles(generator, 5000)
    points = 2 * torch.randn(len(triangles), 3, generator=generator, dtype=torch.float64)
    found = closest_barycentrics(points.float().to(device), triangles.float().to(device)).double().cpu()
    expected = reference(points, triangles)
    assert (found - expected).abs().mean() < 2e-6
    assert torch.allclose(
        distances(points, triangles, found), distances(points, triangles, expected), rtol=0, atol=1e-5
    )
    assert bool((found >= 0).all())
    assert torch.allclose(found.sum(dim=1), torch.ones(len(found), dtype=torch.float64), rtol=0, atol=3e-7)


def test_points_on_the_surface_keep_their_weights(device, generator):
    triangles = make_triangles(generator, 1000)
    weights = torch.rand(1000, 3, generator=generator, dtype=torch.float64)
    weights = weights / weights.sum(dim=1, keepdim=True)
    points = (weights[:, None] @ triangles)[:, 0]
    found = closest_barycentrics(points.float().to(device), triangles.float().to(device)).double().cpu()
    assert bool((distances(points, triangles, found) < 1e-5).all())


def test_follows_the_order_of_the_corners(device, generator):
    triangles = make_triangles(generator, 1000).float().to(device)
    points = 2 * torch.randn(1000, 3, generator=generator).to(device)
    weights = closest_barycentrics(points, triangles)
    for order in ([1, 2, 0], [0, 2, 1]):
        permuted = closest_barycentrics(points, triangles[:, order])
        assert (permuted - weights[:, order]).abs().mean() < 2e-6


DEGENERATE = {
    "point": [[1.0, 2, 3], [1, 2, 3], [1, 2, 3]],
    "a is b": [[0.0, 0, 0], [0, 0, 0], [2, 0, 0]],
    "b is c": [[0.0, 0, 0], [2, 0, 0], [2, 0, 0]],
    "c is a": [[0.0, 0, 0], [2, 0, 0], [0, 0, 0]],
    "a between": [[1.0, 0, 0], [0, 0, 0], [2, 0, 0]],
    "b between": [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]],
    "c between": [[0.0, 0, 0], [2, 0, 0], [1, 0, 0]],
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_triangles_are_segments_and_points(device, generator, name):
    triangles = torch.tensor(DEGENERATE[name], dtype=torch.float64).expand(500, 3, 3).contiguous()
    points = torch.cat([torch.randn(499, 3, generator=generator, dtype=torch.float64) + 1, triangles[:1, 0]])
    found = closest_barycentrics(points.float().to(device), triangles.float().to(device)).double().cpu()
    assert bool(found.isfinite().all())
    assert bool((found >= 0).all())
    assert torch.allclose(found.sum(dim=1), torch.ones(500, dtype=torch.float64), rtol=0, atol=3e-7)
    expected = reference(points, triangles)
    assert torch.allclose(
        distances(points, triangles, found), distances(points, triangles, expected), rtol=0, atol=1e-5
    )


def test_needles_are_finite(device, generator):
    """Collinear but for rounding, in any direction: weights of a point of the triangle, whatever they are."""
    start, end = torch.randn(2, 2000, 3, generator=generator)
    between = torch.lerp(start, end, torch.rand(2000, 1, generator=generator))
    points = torch.randn(2000, 3, generator=generator)
    found = closest_barycentrics(points.to(device), torch.stack([start, end, between], dim=1).to(device))
    assert bool((found >= 0).all())
    assert torch.allclose(found.sum(dim=1), torch.ones(2000, device=device), rtol=0, atol=3e-7)


def test_same_bits_for_any_threads_and_runs(device, generator):
    triangles = make_triangles(generator, 2000).float().repeat(15, 1, 1).to(device)
    points = 2 * torch.randn(len(triangles), 3, generator=generator).to(device)
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        runs.append(closest_barycentrics(points, triangles))
    torch.set_num_threads(before)
    assert torch.equal(runs[0], runs[1])
    assert torch.equal(runs[1], runs[2])


def test_no_points_and_wrong_arguments(device):
    assert closest_barycentrics(
        torch.empty(0, 3, device=device), torch.empty(0, 3, 3, device=device)
    ).shape == (0, 3)
    with pytest.raises(UserError, match="points"):
        closest_barycentrics(torch.zeros(2, 2, device=device), torch.zeros(2, 3, 3, device=device))
    with pytest.raises(UserError, match="triangles"):
        closest_barycentrics(torch.zeros(2, 3, device=device), torch.zeros(3, 3, 3, device=device))
