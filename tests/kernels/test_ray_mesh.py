"""The kept mesh that rays are cast at: a refit answers as a new mesh does, and as brute force in float64."""

import copy
import gc
import math
import pickle
import threading
import weakref

import pytest
import torch
import warp as wp

from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch, stream_of
from samira_warp.support.errors import UserError

FAR = 100.0


@wp.kernel(enable_backward=False)
def _cast(
    mesh: wp.uint64,
    origins: wp.array[wp.vec3],
    directions: wp.array[wp.vec3],
    depths: wp.array[wp.float32],
    faces: wp.array[wp.int32],
) -> None:
    index = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[index], directions[index], 100.0)
    if hit.result:
        depths[index] = hit.t
        faces[index] = hit.face


def cast(mesh, origins, directions):
    """Distance to the first triangle, FAR for none, and its number, -1 for none."""
    depths = torch.full((len(origins),), FAR, device=origins.device)
    faces = torch.full((len(origins),), -1, dtype=torch.int32, device=origins.device)
    launch(_cast, len(origins), mesh.id, origins.contiguous(), directions.contiguous(), depths, faces)
    return depths.cpu(), faces.cpu()


def brute_force(vertices, faces, origins, directions):
    """The same in float64, by solving for the barycentrics and the depth; and how far inside the triangle."""
    a, b, c = vertices.double()[faces.long()].unbind(dim=1)
    origins, directions = origins.double(), directions.double()
    rows = len(origins)
    system = torch.stack(
        [
            (b - a)[None].expand(rows, -1, -1),
            (c - a)[None].expand(rows, -1, -1),
            -directions[:, None].expand(-1, len(a), -1),
        ],
        dim=-1,
    )
    # a triangle without area has no solution: a huge depth
    singular = torch.linalg.det(system).abs() < 1e-12
    system = torch.where(singular[..., None, None], torch.eye(3, dtype=torch.float64), system)
    u, v, depth = torch.linalg.solve(system, origins[:, None] - a[None]).unbind(dim=-1)
    margin = torch.stack([u, v, 1 - u - v]).amin(dim=0)
    hit = (margin >= 0) & (depth > 0) & ~singular
    depth = torch.where(hit, depth, FAR)
    nearest, face = depth.min(dim=1)
    # rays that pass an edge, of any triangle, or two triangles, more closely than float32 can tell
    close = ((margin.abs() < 1e-4) & (depth.abs() < 2 * FAR)).any(dim=1)
    close |= (depth.sort(dim=1).values[:, :2].diff(dim=1)[:, 0].abs() < 1e-4) & (nearest < FAR)
    return nearest, torch.where(nearest < FAR, face, -1), ~close


def make_scene(generator, count=40):
    """A soup of triangles, and where it moves to."""
    faces = torch.arange(3 * count).view(count, 3)
    corner = torch.randn(count, 1, 3, generator=generator)
    vertices = (corner + 0.5 * torch.randn(count, 3, 3, generator=generator)).view(-1, 3)
    moved = vertices @ turn(0.7).T + 0.3 * torch.randn(vertices.shape, generator=generator)
    return vertices, moved, faces


def turn(angle):
    return torch.tensor(
        [[math.cos(angle), 0.0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    )


def make_rays(generator, count=3000):
    origins = torch.randn(count, 3, generator=generator)
    directions = torch.randn(count, 3, generator=generator)
    return origins, torch.nn.functional.normalize(directions, dim=1)


@pytest.mark.parametrize("refitted", [False, True])
def test_rays_find_what_brute_force_finds(device, generator, refitted):
    vertices, moved, faces = make_scene(generator)
    rays = make_rays(generator)
    mesh = RayMesh(vertices.to(device), faces.to(device))
    if refitted:
        mesh.refit(moved.to(device))
    depths, hits = cast(mesh, *(ray.to(device) for ray in rays))
    expected, face, sure = brute_force(moved if refitted else vertices, faces, *rays)
    assert sure.float().mean() > 0.8
    assert 0.2 < (face >= 0).float().mean() < 0.9
    assert torch.equal(hits[sure].long(), face[sure])
    # float32's rounding of coordinates of a few units, over the cosine of a ray that grazes
    torch.testing.assert_close(depths[sure], expected[sure].float(), rtol=1e-4, atol=1e-4)


def test_a_refit_answers_as_a_new_mesh_does_whatever_came_before(device, generator):
    vertices, moved, faces = make_scene(generator)
    rays = [ray.to(device) for ray in make_rays(generator)]
    mesh = RayMesh(vertices.to(device), faces.to(device))
    scattered = 5.0 * torch.randn(vertices.shape, generator=generator)
    for place in (moved, scattered, torch.zeros_like(vertices), vertices):
        mesh.refit(place.to(device))
        fresh = RayMesh(place.to(device), faces.to(device))
        for mine, its in zip(cast(mesh, *rays), cast(fresh, *rays), strict=True):
            # the tests of the triangles are the same, bit by bit; only the order they come in is another
            assert torch.equal(mine, its)
    assert torch.equal(mesh.vertices.cpu(), vertices)


def test_the_mesh_does_not_follow_its_callers_tensors(device, generator):
    vertices, moved, faces = (tensor.to(device) for tensor in make_scene(generator))
    rays = [ray.to(device) for ray in make_rays(generator)]
    mesh = RayMesh(vertices, faces)
    before = cast(mesh, *rays)
    vertices += 100.0
    faces.zero_()
    assert all(torch.equal(now, then) for now, then in zip(cast(mesh, *rays), before, strict=True))
    mesh.refit(moved)
    before = cast(mesh, *rays)
    moved.zero_()
    assert all(torch.equal(now, then) for now, then in zip(cast(mesh, *rays), before, strict=True))


def test_views_of_other_tensors_and_every_integer_type(device, generator):
    vertices, moved, faces = (tensor.to(device) for tensor in make_scene(generator))
    rays = [ray.to(device) for ray in make_rays(generator)]
    expected = cast(RayMesh(vertices, faces), *rays)
    wide = torch.cat([vertices, vertices], dim=1).requires_grad_()
    for ids in (faces.T.contiguous().T, faces.to(torch.uint8), faces.to(torch.int32)):
        mesh = RayMesh(moved, ids)
        mesh.refit(wide[:, 3:])
        found = cast(mesh, *rays)
        assert all(torch.equal(mine, its) for mine, its in zip(found, expected, strict=True))


def test_triangles_without_area_are_met_by_no_ray(device):
    """A square with folded triangles all over it, which rays through their edges and corners do not see."""
    corners = [[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0.5], [0, 0.5, 0.5], [0, 1, 0.5]]
    vertices = torch.tensor(corners, device=device)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 4, 4], [4, 4, 6]], device=device)
    origins = torch.tensor([[0.0, 0.25, 2], [0, 0.5, 2], [0, 1e-3, 2], [0.3, 0.2, 2]], device=device)
    directions = torch.tensor([[0.0, 0, -1]], device=device).expand(4, 3)
    depths, hits = cast(RayMesh(vertices, faces), origins, directions)
    assert depths.tolist() == pytest.approx([2.0] * 4, abs=1e-6)
    assert set(hits.tolist()) <= {0, 1}


def test_a_mesh_of_nothing_can_be_cast_at_and_refitted(device):
    rays = torch.zeros(2, 3, device=device), torch.tensor([[0.0, 0, 1], [1, 0, 0]], device=device)
    for count in (0, 4):
        vertices = torch.zeros(count, 3, device=device)
        mesh = RayMesh(vertices, torch.empty(0, 3, dtype=torch.int32, device=device))
        mesh.refit(vertices)
        assert cast(mesh, *rays)[1].tolist() == [-1, -1]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_vertex_that_is_not_finite_is_named(device, value):
    vertices, faces = torch.eye(3, device=device), torch.tensor([[0, 1, 2]], device=device)
    mesh = RayMesh(vertices, faces)
    vertices[1, 2] = value
    complaint = rf"vertices: expected finite coordinates, found \[0.0, 1.0, {value}\] at vertex 1"
    with pytest.raises(UserError, match=complaint):
        RayMesh(vertices, faces)
    if device.type == "cpu":
        with pytest.raises(UserError, match=complaint):
            mesh.refit(vertices)
        assert torch.equal(mesh.vertices, torch.eye(3)), "a refused refit leaves the mesh where it was"


def test_wrong_tensors_are_named_with_what_was_expected(device):
    vertices, faces = torch.eye(3, device=device), torch.tensor([[0, 1, 2]], device=device)
    for wrong in (vertices[:, :2], vertices[None], vertices.double(), vertices.tolist()):
        with pytest.raises(UserError, match=r"vertices: expected float32 tensor of shape \(V, 3\)"):
            RayMesh(wrong, faces)
    for wrong in (faces[0], faces.to("meta")):
        with pytest.raises(UserError, match=r"faces: expected integer tensor of shape \(F, 3\)"):
            RayMesh(vertices, wrong)
    for wrong, found in ((faces.float(), "float32"), (faces.bool(), "bool")):
        with pytest.raises(
            UserError, match=rf"faces: expected integer tensor of shape \(F, 3\), found {found}"
        ):
            RayMesh(vertices, wrong)
    for wrong, found in ((faces + 1, "1 to 3"), (faces - 1, "-1 to 1")):
        with pytest.raises(UserError, match=f"faces: expected ids 0 to 2, found {found}"):
            RayMesh(vertices, wrong)
    mesh = RayMesh(vertices, faces)
    for wrong in (vertices[:2], vertices.double(), vertices.to("meta")):
        with pytest.raises(UserError, match=r"vertices: expected float32 tensor of shape \(3, 3\)"):
            mesh.refit(wrong)


def test_copies_have_trees_of_their_own(device, generator):
    vertices, moved, faces = (tensor.to(device) for tensor in make_scene(generator))
    rays = [ray.to(device) for ray in make_rays(generator)]
    mesh = RayMesh(vertices, faces)
    expected = cast(mesh, *rays)
    for twin in (copy.copy(mesh), copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        assert twin.id != mesh.id
        mesh.refit(moved)
        assert all(torch.equal(mine, its) for mine, its in zip(cast(twin, *rays), expected, strict=True))
        mesh.refit(vertices)


def test_a_mesh_made_in_inference_mode_can_be_refitted_outside_and_the_other_way_round(device):
    with torch.inference_mode():
        vertices, faces = torch.eye(3, device=device), torch.tensor([[0, 1, 2]], device=device)
        mesh = RayMesh(vertices, faces)
    mesh.refit(2.0 * torch.eye(3, device=device))
    with torch.inference_mode():
        mesh.refit(vertices)
    assert torch.equal(mesh.vertices, torch.eye(3, device=device))


def test_threads_share_a_mesh_and_have_their_own(device, generator):
    vertices, moved, faces = (tensor.to(device) for tensor in make_scene(generator))
    rays = [ray.to(device) for ray in make_rays(generator)]
    shared = RayMesh(vertices, faces)
    expected = [cast(RayMesh(place, faces), *rays) for place in (vertices, moved)]
    together, wrong = threading.Barrier(4), []

    def work():
        together.wait()
        for _ in range(20):
            own = RayMesh(vertices, faces)
            own.refit(moved)
            for mesh, right in zip((shared, own), expected, strict=True):
                found = cast(mesh, *rays)
                wrong.extend(
                    mesh.id for one, two in zip(found, right, strict=True) if not torch.equal(one, two)
                )

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_mesh_that_is_given_up_is_freed(device):
    mesh = RayMesh(torch.eye(3, device=device), torch.tensor([[0, 1, 2]], device=device))
    tree, vertices = weakref.ref(mesh._held[0]), weakref.ref(mesh.vertices)
    del mesh
    gc.collect()
    assert tree() is None
    assert vertices() is None


@pytest.mark.gpu
def test_work_in_another_stream_is_in_order(generator):
    """What is refitted and cast in a stream of torch's pool waits for the vertices that are made there."""
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    device = torch.device("cuda", torch.cuda.current_device())
    vertices, moved, faces = (tensor.to(device) for tensor in make_scene(generator))
    rays = [ray.to(device) for ray in make_rays(generator)]
    expected = cast(RayMesh(moved, faces), *rays)
    mesh, place = RayMesh(vertices, faces), vertices.clone()
    torch.cuda.synchronize()
    stream = torch.cuda.Stream(device)
    with torch.cuda.stream(stream):
        for _ in range(20):
            torch.cuda._sleep(10_000_000)
            place.copy_(moved)
            mesh.refit(place)
            found = cast(mesh, *rays)
            assert all(torch.equal(mine, its) for mine, its in zip(found, expected, strict=True))
            # freed while its rays may be on their way
            short = RayMesh(moved, faces)
            short.refit(vertices)
            place.copy_(vertices)
            mesh.refit(place)
            del short
    with stream_of(device):
        assert wp.get_stream(str(device)).cuda_stream == torch.cuda.current_stream(device).cuda_stream
