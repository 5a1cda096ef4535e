import pytest
import torch

from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.reference.mesh.triangle_frames import triangle_frames as reference
from samira_warp.support.errors import UserError


def make_mesh(generator, device, vertices=600, faces=3000):
    """A soup of triangles that share vertices, about 0.1 across, none of them thin, and a last vertex that no
    face uses."""
    points = 0.1 * torch.randn(vertices, 3, generator=generator)
    candidates = torch.randint(vertices - 1, (4 * faces, 3), generator=generator)
    a, b, c = points[candidates].unbind(dim=1)
    height = torch.linalg.cross(b - a, c - a).norm(dim=1) / torch.stack([b - a, c - a, c - b]).norm(
        dim=2
    ).amax(dim=0).clamp(min=1e-9)
    candidates = candidates[height > 0.02][:faces]
    assert len(candidates) == faces
    return points.to(device), MeshTopology.build(candidates.to(device), vertices)


def make_weights(generator, device, faces):
    return [torch.randn(faces, *shape, generator=generator).to(device) for shape in ((3, 3), (3,), ())]


def random_rotation(generator):
    q, r = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    q = q * r.diagonal().sign()
    return q * torch.linalg.det(q)


def test_a_known_triangle(device):
    vertices = torch.tensor([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [1.0, 2.0, 0.0]], device=device)
    frames = triangle_frames(vertices, MeshTopology.build(torch.tensor([[0, 1, 2]], device=device), 3))
    # Columns: along the edge (+x), the normal (+z), their cross product (-y); length 4 and height 2.
    assert torch.allclose(
        frames.rotation[0].cpu(), torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), rtol=0, atol=1e-7
    )
    assert torch.allclose(frames.translation[0].cpu(), torch.tensor([5 / 3, 2 / 3, 0]), rtol=0, atol=1e-6)
    assert frames.scale.item() == pytest.approx(3.0, rel=1e-6)


def test_matches_the_twin_and_its_gradient(device, generator):
    vertices, topology = make_mesh(generator, device)
    weights = make_weights(generator, device, len(topology.faces))
    leaf, exact = vertices.clone().requires_grad_(), vertices.double().requires_grad_()
    found, expected = triangle_frames(leaf, topology), reference(exact, topology)
    for one, other in zip(found, expected, strict=True):
        # Lengths of 0.1 to 2^-24, directions after a division by heights above 0.02: 0.1 * 6e-8 / 0.02 =
        # 3e-7, a few times over.
        assert torch.allclose(one.double(), other, rtol=0, atol=2e-6)
    (grad,) = torch.autograd.grad(found, leaf, weights)
    (exact_grad,) = torch.autograd.grad(expected, exact, [weight.double() for weight in weights])
    assert (grad.double() - exact_grad).norm() < 1e-5 * exact_grad.norm()
    assert (
        torch.nn.functional.cosine_similarity(grad.double().flatten(), exact_grad.flatten(), dim=0) > 1 - 1e-9
    )


@pytest.mark.parametrize("output", ["rotation", "translation", "scale"])
def test_gradient_of_each_output_alone(device, generator, output):
    vertices, topology = make_mesh(generator, device, faces=500)
    leaf, exact = vertices.clone().requires_grad_(), vertices.double().requires_grad_()
    found, expected = (
        getattr(triangle_frames(leaf, topology), output),
        getattr(reference(exact, topology), output),
    )
    weight = torch.randn(found.shape, generator=generator).to(device)
    (grad,), (exact_grad,) = (
        torch.autograd.grad(found, leaf, weight),
        torch.autograd.grad(expected, exact, weight.double()),
    )
    assert (grad.double() - exact_grad).norm() < 1e-5 * exact_grad.norm()


def test_twin_by_finite_differences(generator):
    vertices, topology = make_mesh(generator, "cpu", vertices=12, faces=6)
    # In units of a triangle: gradcheck's tolerances are absolute.
    vertices = (10 * vertices.double()).requires_grad_()
    assert torch.autograd.gradcheck(lambda vertices: tuple(reference(vertices, topology)), vertices)


def test_rotations_are_rotations_and_follow_rigid_motion(device, generator):
    vertices, topology = make_mesh(generator, device)
    frames = triangle_frames(vertices, topology)
    r = frames.rotation.double()
    assert torch.allclose(
        r.mT @ r, torch.eye(3, dtype=torch.float64, device=device).expand_as(r), rtol=0, atol=1e-6
    )
    assert torch.allclose(
        torch.linalg.det(r), torch.ones(len(r), dtype=torch.float64, device=device), rtol=0, atol=1e-6
    )

    turn, shift = (
        random_rotation(generator).to(device),
        torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64, device=device),
    )
    moved = triangle_frames((vertices.double() @ turn.T + shift).float(), topology)
    # The moved vertices are rounded to 0.5 * 2^-24: 3e-8 / 0.02 = 1.5e-6 in a direction, a few times over.
    assert torch.allclose(moved.rotation.double(), turn @ r, rtol=0, atol=1e-5)
    assert torch.allclose(
        moved.translation.double(), frames.translation.double() @ turn.T + shift, rtol=0, atol=2e-7
    )
    assert torch.allclose(moved.scale, frames.scale, rtol=0, atol=2e-7)


def test_moving_the_whole_mesh_has_no_gradient_in_shape(device, generator):
    """Rotation and scale ignore translation: over the vertices, their gradient sums to nothing."""
    vertices, topology = make_mesh(generator, device)
    weights = make_weights(generator, device, len(topology.faces))
    leaf = vertices.clone().requires_grad_()
    frames = triangle_frames(leaf, topology)
    (grad,) = torch.autograd.grad((frames.rotation, frames.scale), leaf, (weights[0], weights[2]))
    assert grad.double().sum(dim=0).norm() < 1e-5 * grad.norm()


DEGENERATE = {
    "point": [[1.0, 2, 3], [1, 2, 3], [1, 2, 3]],
    "no first edge": [[1.0, 2, 3], [1, 2, 3], [4, 5, 6]],
    "no last edge": [[1.0, 2, 3], [4, 5, 7], [4, 5, 7]],
    "no side": [[1.0, 2, 3], [4, 5, 7], [1, 2, 3]],
    "collinear": [[0.0, 0, 0], [2, 0, 0], [5, 0, 0]],
    "nearly collinear": [[0.0, 0, 0], [2, 0, 0], [1, 1e-6, 0]],
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_triangles(device, generator, name):
    """Constant rotation and scale, the centroid as ever, beside a healthy triangle that is not disturbed."""
    corners = torch.tensor([*DEGENERATE[name], [0.0, 0, 0], [1, 0, 0], [0, 1, 0]], device=device)
    topology = MeshTopology.build(torch.tensor([[0, 1, 2], [3, 4, 5]], device=device), 6)
    leaf, exact = corners.clone().requires_grad_(), corners.double().requires_grad_()
    found, expected = triangle_frames(leaf, topology), reference(exact, topology)
    for one, other in zip(found, expected, strict=True):
        assert torch.allclose(one.double(), other, rtol=0, atol=1e-6)
    assert torch.equal(found.rotation[0].cpu(), torch.eye(3))
    weights = make_weights(generator, device, 2)
    (grad,) = torch.autograd.grad(found, leaf, weights)
    assert torch.allclose(grad[:3], (weights[1][0] / 3).expand(3, 3), rtol=0, atol=1e-6)
    (exact_grad,) = torch.autograd.grad(expected, exact, [weight.double() for weight in weights])
    assert torch.allclose(grad.double(), exact_grad, rtol=0, atol=1e-5)


def test_small_but_healthy_triangles_keep_their_frames(device, generator):
    """What is degenerate is a matter of shape, not of size."""
    vertices, topology = make_mesh(generator, device)
    small = triangle_frames(vertices * 2.0**-20, topology)
    frames = triangle_frames(vertices, topology)
    assert torch.allclose(small.rotation, frames.rotation, rtol=0, atol=1e-6)
    assert torch.allclose(small.scale * 2.0**20, frames.scale, rtol=1e-5)


def test_same_bits_for_any_threads_and_runs(device, generator):
    vertices, topology = make_mesh(generator, device, vertices=5000, faces=12000)
    weights = make_weights(generator, device, 12000)
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        leaf = vertices.clone().requires_grad_()
        frames = triangle_frames(leaf, topology)
        (first,) = torch.autograd.grad(frames, leaf, weights, retain_graph=True)
        (second,) = torch.autograd.grad(frames, leaf, weights)
        assert torch.equal(first, second)
        runs.append((*frames, first))
    torch.set_num_threads(before)
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


def test_no_faces(device):
    topology = MeshTopology.build(torch.empty(0, 3, dtype=torch.int64, device=device), 4)
    vertices = torch.ones(4, 3, device=device, requires_grad=True)
    frames = triangle_frames(vertices, topology)
    assert frames.rotation.shape == (0, 3, 3)
    (grad,) = torch.autograd.grad(sum(part.sum() for part in frames), vertices)
    assert not grad.any()


def test_wrong_arguments_are_a_users_error(device):
    faces = torch.tensor([[0, 1, 2]], device=device)
    with pytest.raises(UserError, match="faces"):
        MeshTopology.build(faces, 2)
    with pytest.raises(UserError, match="faces"):
        MeshTopology.build(faces[:, :2], 3)
    with pytest.raises(UserError, match="vertices"):
        triangle_frames(torch.zeros(4, 3, device=device), MeshTopology.build(faces, 3))
