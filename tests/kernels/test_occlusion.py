"""Blocked directions: against brute force in float64, closed forms, and what must hold to the bit."""

import math

import pytest
import torch
from kernels.test_visibility import make_sphere

from samira_warp.kernels import MeshTopology, mesh_normals
from samira_warp.kernels.rays.occlusion import unblocked
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.reference.rays.occlusion import unblocked as reference
from samira_warp.reference.rays.ray_mesh import RayMesh as PlainMesh
from samira_warp.support.errors import UserError

normalize = torch.nn.functional.normalize


def unpack(words):
    """(M, D) bool of (M, D / 32) int32."""
    return ((words.cpu()[..., None] >> torch.arange(32)) & 1).bool().flatten(1)


def cube_directions(size=8):
    """Texel centres of a cubemap, 4 x 4 of a face after 4 x 4."""
    place = (torch.arange(size) + 0.5) * 2 / size - 1
    v, u = torch.meshgrid(place, place, indexing="ij")
    plane = torch.stack([torch.ones(size, size), u, v], dim=-1)
    blocks = plane.unfold(0, 4, 4).unfold(1, 4, 4).movedim(2, -1).reshape(-1, 3)
    faces = [sign * blocks.roll(axis, dims=1) for axis in range(3) for sign in (1.0, -1.0)]
    return normalize(torch.cat(faces), dim=1)


def random_directions(generator, count):
    return normalize(torch.randn(count, 3, generator=generator), dim=1)


def cast(device, points, normals, vertices, faces, directions, **options):
    mesh = RayMesh(vertices.to(device), faces.to(device))
    inputs = (points.to(device), normals.to(device), mesh, directions.to(device))
    return unpack(unblocked(*inputs, **options))


def normals_of(vertices, faces):
    return mesh_normals(vertices[None], MeshTopology.build(faces, len(vertices)))[0]


def assert_matches_the_twin(device, points, normals, vertices, faces, directions, tolerance, *, sure=0.99):
    """The same bits wherever the twin says that they do not hang by ``tolerance``."""
    found = cast(device, points, normals, vertices, faces, directions)
    doubles = (tensor.double() for tensor in (points, normals, vertices, directions))
    points, normals, vertices, directions = doubles
    expected = reference(points, normals, PlainMesh(vertices, faces), directions)
    certain = expected.margins > tolerance
    assert certain.float().mean() > sure
    assert torch.equal(found[certain], unpack(expected.bits)[certain])
    return found


# ---- Against brute force. What decides is a sum of products of coordinates relative to the point, each
# rounded to 2^-24, over an edge's length: some ten roundings of the largest distance in the scene, with the
# overlap of 4e-7 of it on the CPU: together below 1e-6 of it. On a GPU rays begin at a rounded place besides.


@pytest.mark.parametrize("count", [1, 7, 8, 9, 64, 65, 600])
def test_a_soup_matches_the_twin(device, generator, count):
    vertices = (
        torch.randn(count, 1, 3, generator=generator) + 0.4 * torch.randn(count, 3, 3, generator=generator)
    ).view(-1, 3)
    faces = torch.arange(3 * count).view(count, 3)
    points = torch.randn(60, 3, generator=generator)
    normals = random_directions(generator, 60)
    directions = random_directions(generator, 96)
    found = assert_matches_the_twin(device, points, normals, vertices, faces, directions, 1e-5)
    assert not found.all()


@pytest.mark.parametrize("away", [0.0, 1.0])
def test_vertices_of_a_bumpy_sphere_match_the_twin(device, generator, away):
    """Points on the mesh, their own triangles about them, valleys among them; the head's size, in metres."""
    vertices, faces = make_sphere(24, 48)
    waves = 0.2 * (vertices @ torch.randn(3, 4, generator=generator) * 5).sin().sum(dim=1, keepdim=True)
    vertices = 0.1 * vertices * (1 + waves) + away
    normals = normals_of(vertices, faces)
    some = torch.randperm(len(vertices), generator=generator)[:20]
    # 1e-6 of the 0.2 m; a metre away a GPU's start is rounded to 2^-24 of a metre
    tolerance = 2e-7 if device.type == "cpu" else 2e-7 + 2e-7 * away
    found = assert_matches_the_twin(
        device, vertices[some], normals[some], vertices, faces, cube_directions(), tolerance, sure=0.95
    )
    assert 0.02 < (~found).float().mean() < 0.9


def test_more_directions_than_one_walk_takes(device, generator):
    vertices, faces = make_sphere(8, 12)
    points = 2.0 * random_directions(generator, 20)
    directions = random_directions(generator, 1056)
    assert_matches_the_twin(device, points, -normalize(points, dim=1), vertices, faces, directions, 1e-5)


@pytest.mark.parametrize("spread", [0.0, 1e-4, 0.02])
def test_a_narrow_bundle_matches_the_twin(device, generator, spread):
    """The directions of a small light, all but one."""
    vertices, faces = make_sphere(16, 32)
    points = torch.tensor([0.0, 0.0, 3.0]) + torch.randn(200, 3, generator=generator)
    normals = normalize(torch.tensor([0.1, 0.2, -1.0]).expand(200, 3), dim=1)
    bundle = torch.tensor([0.05, 0.1, -1.0]) + spread * torch.randn(32, 3, generator=generator)
    assert_matches_the_twin(
        device, points, normals, vertices, faces, normalize(bundle, dim=1), 1e-5, sure=0.97
    )


# ---- Closed forms.


def test_a_sphere_over_a_plane_blocks_its_cone(device):
    """From a point of the plane, the directions within asin(radius / distance) of the centre, but for those
    between the sphere of the corners and the one within the facets."""
    vertices, faces = make_sphere(48, 96)
    points = torch.tensor([[x, y, -1.5] for x in (-2.0, 0.0, 1.0) for y in (0.0, 0.7)])
    normals = torch.tensor([0.0, 0.0, 1.0]).expand(len(points), 3)
    directions = cube_directions(16)
    found = cast(device, points, normals, vertices, faces, directions)
    cosine = normalize(-points, dim=1) @ directions.T
    up = directions[:, 2] > 0
    distance = points.norm(dim=1, keepdim=True)
    # facets of 2 pi / 96 by pi / 48 lie nearer to the centre by the cosine of half their diagonal
    inner = math.cos(math.hypot(math.pi / 96, math.pi / 96))
    blocked = up & (cosine > (1 - (inner / distance) ** 2).sqrt() + 1e-6)
    free = ~up | (cosine < (1 - (1 / distance) ** 2).sqrt() - 1e-6)
    assert blocked.any()
    assert not found[blocked].any()
    assert found[free].all()
    assert (blocked | free).float().mean() > 0.995


def test_two_spheres_block_each_other(device):
    """The foremost point of either sees the other's cap, and nothing of its own."""
    sphere, faces = make_sphere(24, 48)
    centre = torch.tensor([0.0, 0.0, 3.0])
    vertices, both = torch.cat([sphere, sphere + centre]), torch.cat([faces, faces + len(sphere)])
    points = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, -1], [0, 0, 4]])
    normals = torch.tensor([[0.0, 0, 1], [0, 0, -1], [0, 0, -1], [0, 0, 1]])
    directions = cube_directions(16)
    found = cast(device, points, normals, vertices, both, directions)
    cosine = normals[:2] @ directions.T
    # the other's centre is two radii away: a cap of 30 degrees, the facets' chords 0.3 % nearer
    assert not found[:2][cosine > math.cos(math.radians(29.7))].any()
    assert found[:2][cosine < math.cos(math.radians(30.01))].all()
    assert found[2:].all()


def make_box():
    corners = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[a, b, c] for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    return corners, torch.tensor(faces)


@pytest.mark.parametrize("inverted", [False, True])
def test_nothing_leaves_a_closed_box(device, generator, inverted):
    """Whichever way its faces are turned, rays through its very edges, diagonals and corners among them."""
    corners, faces = make_box()
    faces = faces.flip(1) if inverted else faces
    edges = 0.5 * (corners[:, None] + corners[None]).view(-1, 3)
    through = normalize(torch.cat([corners, edges[edges.abs().amax(dim=1) > 0]]), dim=1)
    through = torch.cat([through, random_directions(generator, -len(through) % 32)])
    points = torch.cat([torch.zeros(1, 3), 0.9 * (2 * torch.rand(40, 3, generator=generator) - 1)])
    normals = random_directions(generator, len(points))
    for directions in (cube_directions(), through):
        above = normals @ directions.T > 0
        found = cast(device, points, normals, corners, faces, directions)
        assert found[~above].all()
        if device.type == "cpu" or directions is not through:
            assert not found[above].any()


def test_a_bowl_is_open_at_the_top(device):
    """From the bottom of half a sphere: free within 45 degrees of the axis, blocked below."""
    vertices, faces = make_sphere(48, 96)
    bowl = faces[(vertices[faces][..., 2] < 1e-4).all(dim=1)]
    point, normal = torch.tensor([[0.0, 0.0, -0.999]]), torch.tensor([[0.0, 0.0, 1.0]])
    directions = cube_directions(16)
    found = cast(device, point, normal, vertices, bowl, directions)[0]
    height = directions[:, 2]
    # the rim, seen from 0.999 below it, stands at 44.97 degrees, the middle of a chord at 44.99
    assert found[(height > math.sin(math.radians(45.1))) | (height <= 0)].all()
    assert not found[(height < math.sin(math.radians(44.9))) & (height > 1e-3)].any()


# ---- To the bit.


@pytest.mark.parametrize("away", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("shape", ["sphere", "ellipsoid", "box"])
def test_a_convex_body_is_unblocked_to_the_bit(device, generator, shape, away):
    if shape == "box":
        vertices, faces = make_box()
        vertices = 0.1 * vertices
        normals = normalize(vertices, dim=1)
    else:
        vertices, faces = make_sphere(40, 80)
        axes = torch.tensor([0.075, 0.11, 0.09] if shape == "ellipsoid" else [0.1, 0.1, 0.1])
        # of the body, not of its facets: nothing of a convex body is above its own tangents
        vertices, normals = vertices * axes, normalize(vertices / axes, dim=1)
    vertices = vertices + away * torch.tensor([0.6, -0.5, 0.62])
    directions = torch.cat([cube_directions(), random_directions(generator, 512)])
    inputs = [tensor.to(device) for tensor in (vertices, normals, vertices, faces, directions)]
    points, normals, vertices, faces, directions = inputs
    words = unblocked(points, normals, RayMesh(vertices, faces), directions)
    assert (words == -1).all()


def test_no_ray_leaves_a_sphere_by_its_edges_or_vertices(device, generator):
    """From random places within, at vertices and at points of edges; by Warp's trees some do."""
    if device.type != "cpu":
        pytest.skip("Warp's rays slip through vertices: see RayMesh")
    vertices, faces = make_sphere(40, 80)
    vertices = vertices + 0.3
    for place in 0.3 + 0.5 * torch.randn(40, 3, generator=generator).clamp(-1, 1):
        a, b = vertices[faces[:, 0]], vertices[faces[:, 1]]
        share = torch.rand(len(a), 1, generator=generator)
        targets = torch.cat([vertices, torch.lerp(a, b, share)]) - place
        targets = targets[targets.norm(dim=1) > 0.01]
        directions = normalize(targets[: len(targets) // 32 * 32], dim=1)
        for normal in (torch.tensor([0.0, 0, 1]), torch.tensor([0.0, 0, -1])):
            found = cast(device, place[None], normal[None], vertices, faces, directions, offset=0.0)
            assert not found[0][directions @ normal > 1e-6].any()


def test_a_point_between_lids_sees_neither_side_out(device, generator):
    """Two sheets a hundredth of a millimetre apart, of triangles of 2 mm, half a metre from the origin."""
    step = 0.002 * torch.arange(11.0)
    grid = torch.stack([*torch.meshgrid(step, step, indexing="ij"), torch.zeros(11, 11)], dim=-1).view(-1, 3)
    corner = (torch.arange(10)[:, None] * 11 + torch.arange(10)).flatten()
    faces = torch.cat(
        [
            torch.stack([corner, corner + 11, corner + 12], 1),
            torch.stack([corner, corner + 12, corner + 1], 1),
        ]
    )
    low = grid + 0.5
    high = low + torch.tensor([0.0, 0.0, 1e-5])
    vertices, both = torch.cat([low, high]), torch.cat([faces, faces + len(low)])
    inner = low.view(11, 11, 3)[2:9, 2:9].reshape(-1, 3)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(len(inner), 3)
    directions = cube_directions()
    # within the sheets: 4 mm to the side at 1e-5 m is below a hundredth of the height
    steep = directions[:, 2].abs() > 0.01
    above, below = steep & (directions[:, 2] > 0), steep & (directions[:, 2] < 0)
    found = cast(device, inner, up, vertices, both, directions)
    assert not found[:, above].any()
    found = cast(device, inner + torch.tensor([0.0, 0.0, 5e-6]), -up, vertices, both, directions)
    assert not found[:, below].any()


def test_same_bits_for_any_threads_and_runs(device, generator, use_threads):
    vertices, faces = make_sphere()
    vertices = vertices * (1 + 0.1 * torch.randn(len(vertices), 1, generator=generator))
    inputs = [t.to(device) for t in (vertices, normals_of(vertices, faces), cube_directions(), faces)]
    points, normals, directions, faces = inputs
    mesh, runs = RayMesh(points, faces), []
    for threads in (1, 2, 2):
        use_threads(threads)
        runs.append(unblocked(points, normals, mesh, directions))
    assert torch.equal(runs[0], runs[1])
    assert torch.equal(runs[1], runs[2])


def test_a_refit_answers_as_a_new_mesh_does(device, generator):
    vertices, faces = make_sphere(12, 24)
    moved = vertices * torch.tensor([1.3, 0.6, 1.0]) + 0.2 * torch.randn(vertices.shape, generator=generator)
    normals = normals_of(moved, faces).to(device)
    vertices, moved, faces, directions = (t.to(device) for t in (vertices, moved, faces, cube_directions()))
    mesh = RayMesh(vertices, faces)
    unblocked(vertices, normals, mesh, directions)
    mesh.refit(moved)
    expected = unblocked(moved, normals, RayMesh(moved, faces), directions)
    assert not (expected == -1).all()
    assert torch.equal(unblocked(moved, normals, mesh, directions), expected)


def test_the_order_of_directions_is_of_no_account(device, generator):
    vertices, faces = make_sphere(12, 24)
    points = 1.5 * random_directions(generator, 200)
    normals, directions = random_directions(generator, 200), cube_directions()
    order = torch.randperm(len(directions), generator=generator)
    found = cast(device, points, normals, vertices, faces, directions)
    assert torch.equal(cast(device, points, normals, vertices, faces, directions[order]), found[:, order])


# ---- Degenerate input.


def test_normals_of_zero_and_nothing_to_do(device):
    vertices, faces = make_box()
    points = torch.zeros(3, 3)
    assert cast(device, points, points, vertices, faces, cube_directions()).all()
    assert cast(device, points[:0], points[:0], vertices, faces, cube_directions()).shape == (0, 384)
    assert cast(device, points, points, vertices, faces, points[:0]).shape == (3, 0)
    for none in (vertices, vertices[:0]):
        assert cast(device, points, points + 0.6, none, faces[:0], cube_directions()).all()


def test_triangles_without_area_block_nothing(device):
    """Points, and edges there and back, among them rays' own starts and targets."""
    vertices = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0.3, 0.7, 1.1], [0, 0, 0]])
    faces = torch.tensor([[0, 0, 0], [0, 1, 0], [1, 2, 2], [3, 3, 0], [3, 2, 3]])
    directions = torch.cat([normalize(vertices[:3], dim=1), random_directions(torch.Generator(), 29)])
    points = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0.3, 0.7, 1.1]])
    assert cast(device, points, torch.tensor([0.0, 0, 1]).expand(3, 3), vertices, faces, directions).all()


def test_fans_and_sheets_that_share_an_edge_many_times_match_the_twin(device, generator):
    """Five triangles on one edge, one of them twice and turned over."""
    vertices = torch.cat([torch.tensor([[0.0, 0, -1], [0, 0, 1]]), torch.randn(5, 3, generator=generator)])
    faces = torch.tensor([[0, 1, k] for k in range(2, 7)] + [[3, 1, 0]])
    points = 2.0 * random_directions(generator, 100)
    normals, directions = -normalize(points, dim=1), random_directions(generator, 96)
    assert_matches_the_twin(device, points, normals, vertices, faces, directions, 1e-5)


def test_a_vertex_far_away_spoils_nothing(device, generator):
    """A kilometre-long sliver, in metres, beside a head: what does not meet it is as without."""
    vertices, faces = make_sphere(12, 24)
    far = torch.cat([vertices, torch.tensor([[1e6, 1e6, 1e6], [1e6, 1e6 + 1.0, 1e6], [-1e6, 0.0, -2e6]])])
    with_far = torch.cat([faces, len(vertices) + torch.tensor([[0, 1, 0], [0, 1, 1]]), faces[:3]])
    points = 1.5 * random_directions(generator, 100)
    normals, directions = -normalize(points, dim=1), cube_directions()
    expected = cast(device, points, normals, vertices, faces, directions)
    assert torch.equal(cast(device, points, normals, far, with_far, directions), expected)
    huge = len(vertices) + torch.tensor([[0, 1, 2]])
    moved = cast(device, points, normals, far, torch.cat([faces, huge]), directions)
    assert (moved & ~expected).sum() == 0
    assert (moved != expected).float().mean() < 0.05


def test_wrong_arguments_are_a_users_error(device):
    mesh = RayMesh(torch.eye(3, device=device), torch.tensor([[0, 1, 2]], device=device))
    points, directions = torch.ones(2, 3, device=device), torch.ones(40, 3, device=device)
    with pytest.raises(UserError, match="directions: expected a multiple of 32 directions, found 40"):
        unblocked(points, points, mesh, directions)
    with pytest.raises(UserError, match=r"normals: expected float32 tensor of shape \(2, 3\)"):
        unblocked(points, points[:1], mesh, directions[:32])
