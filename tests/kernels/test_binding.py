import pytest
import torch

from samira_warp.kernels.mesh.binding import BoundGaussians, FaceBinding, bind
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames, triangle_frames
from samira_warp.reference.mesh.binding import bind as reference
from samira_warp.reference.mesh.binding import quaternion_product, rotation_to_quaternion
from samira_warp.reference.mesh.triangle_frames import triangle_frames as reference_frames
from samira_warp.support.errors import UserError

INPUTS = ("means", "quaternions", "scales", "normals")


def quaternion_to_rotation(q):
    """(N, 3, 3) from unit (w, x, y, z), by the textbook's formula."""
    w, x, y, z = torch.nn.functional.normalize(q, dim=1).unbind(dim=1)
    rows = (
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    )
    return torch.stack(rows, dim=1)


def make_frames(generator, device, faces):
    """Random rotations, among them quarter and half turns about the axes, where a quaternion's largest
    component changes."""
    q = torch.randn(faces, 4, generator=generator, dtype=torch.float64)
    special = torch.tensor(
        [
            [1.0, 0, 0, 0],
            [0, 1, 0, 0],
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [1, 1, 0, 0],
            [0, 1, 1, 0],
            [1, 1, 1, 1],
            [1, 1, 1, -1],
        ]
    )
    q[: len(special)] = special[:faces]
    rotation = quaternion_to_rotation(q).float()
    translation = torch.randn(faces, 3, generator=generator)
    scale = 0.2 + torch.rand(faces, generator=generator)
    return TriangleFrames(rotation.to(device), translation.to(device), scale.to(device))


def make_gaussians(generator, device, count):
    means, normals = torch.randn(count, 3, generator=generator), torch.randn(count, 3, generator=generator)
    quaternions = torch.randn(count, 4, generator=generator) + torch.tensor([0.5, 0, 0, 0])
    scales = torch.exp(torch.randn(count, 3, generator=generator))
    return [tensor.to(device) for tensor in (means, quaternions, scales, normals)]


def make_case(generator, device, count=2000, faces=150):
    """Some faces hold many Gaussians; the last two hold none."""
    binding = FaceBinding.build(torch.randint(faces - 2, (count,), generator=generator).to(device), faces)
    return make_gaussians(generator, device, count), binding, make_frames(generator, device, faces)


def make_weights(generator, device, count):
    return BoundGaussians(
        *(torch.randn(count, size, generator=generator).to(device) for size in (3, 4, 3, 3))
    )


def with_gradients(function, gaussians, binding, frames, weights, dtype=torch.float32):
    leaves = [tensor.to(dtype, copy=True).requires_grad_() for tensor in (*gaussians, *frames)]
    bound = function(*leaves[:4], binding, TriangleFrames(*leaves[4:]))
    return bound, torch.autograd.grad(bound, leaves, [weight.to(dtype) for weight in weights])


def aligned(quaternions, like):
    """The sign of a quaternion is arbitrary: the one nearer to ``like``."""
    return quaternions * (quaternions * like).sum(dim=1, keepdim=True).sign()


def tangent(grad, rotation):
    """The part of dL/dr along the turns [w]x r of r: what a rotation can follow."""
    turning = grad @ rotation.mT
    return (turning - turning.mT) / 2 @ rotation


def test_matches_the_twin(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    found = bind(*gaussians, binding, frames)
    double = [tensor.double() for tensor in gaussians], TriangleFrames(*(part.double() for part in frames))
    expected = reference(*double[0], binding, double[1])
    # Products and sums of numbers up to about 10, to 2^-24 each.
    assert torch.allclose(found.means.double(), expected.means, rtol=0, atol=3e-6)
    assert torch.allclose(found.scales.double(), expected.scales, rtol=3e-7)
    assert torch.allclose(found.normals.double(), expected.normals, rtol=0, atol=1e-6)
    assert torch.allclose(
        aligned(found.quaternions.double(), expected.quaternions), expected.quaternions, rtol=0, atol=2e-6
    )


def test_the_rotations_compose(device, generator):
    """As matrices, with nothing of the twin: R(q') = r R(q), n' = unit(r n), and unit lengths."""
    gaussians, binding, frames = make_case(generator, device)
    bound = bind(*gaussians, binding, frames)
    r = frames.rotation.double()[binding.faces.long()]
    expected = r @ quaternion_to_rotation(gaussians[1].double())
    assert torch.allclose(quaternion_to_rotation(bound.quaternions.double()), expected, rtol=0, atol=3e-6)
    ones = torch.ones(len(r), device=device)
    assert torch.allclose(bound.quaternions.norm(dim=1), ones, rtol=0, atol=1e-6)
    assert torch.allclose(bound.normals.norm(dim=1), ones, rtol=0, atol=1e-6)


def test_gradients_match_the_twin(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    weights = make_weights(generator, device, 2000)
    found, grads = with_gradients(bind, gaussians, binding, frames, weights)
    # The twin's q' may have the other sign: its weight takes that sign too.
    twin = reference(
        *(tensor.double() for tensor in gaussians),
        binding,
        TriangleFrames(*(part.double() for part in frames)),
    )
    sign = (found.quaternions.double() * twin.quaternions).sum(dim=1, keepdim=True).sign()
    weights = weights._replace(quaternions=weights.quaternions.double() * sign)
    _, expected = with_gradients(reference, gaussians, binding, frames, weights, torch.float64)
    expected = [*expected[:4], tangent(expected[4], frames.rotation.double()), *expected[5:]]
    for name, one, other in zip((*INPUTS, *TriangleFrames._fields), grads, expected, strict=True):
        assert (one.double() - other).norm() < 3e-6 * other.norm(), name
        assert (
            torch.nn.functional.cosine_similarity(one.double().flatten(), other.flatten(), dim=0) > 1 - 1e-10
        ), name
    assert not any(grad[-2:].any() for grad in grads[4:]), "faces without Gaussians have no gradient"


@pytest.mark.parametrize("output", INPUTS)
def test_gradient_of_each_output_to_the_vertices(device, generator, output):
    """Through the frames to the mesh, where only the rotation's tangential gradient can arrive."""
    corners = torch.randn(90, 3, generator=generator).view(30, 3, 3)
    corners[:, 2] += 2 * torch.nn.functional.normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], torch.ones(30, 3)), dim=1
    )
    vertices = corners.view(-1, 3).to(device)
    topology = MeshTopology.build(torch.arange(90, device=device).view(30, 3), 90)
    binding = FaceBinding.build(torch.randint(30, (300,), generator=generator).to(device), 30)
    gaussians = make_gaussians(generator, device, 300)
    leaf, exact = vertices.clone().requires_grad_(), vertices.double().requires_grad_()
    found = getattr(bind(*gaussians, binding, triangle_frames(leaf, topology)), output)
    twin = reference(*(tensor.double() for tensor in gaussians), binding, reference_frames(exact, topology))
    expected = getattr(twin, output)
    if output == "quaternions":
        expected = aligned(expected, found.detach().double())
    weight = torch.randn(found.shape, generator=generator).to(device)
    (grad,), (exact_grad,) = (
        torch.autograd.grad(found, leaf, weight),
        torch.autograd.grad(expected, exact, weight.double()),
    )
    assert (grad.double() - exact_grad).norm() < 2e-5 * exact_grad.norm()
    assert (
        torch.nn.functional.cosine_similarity(grad.double().flatten(), exact_grad.flatten(), dim=0) > 1 - 1e-9
    )


def test_twin_by_finite_differences(generator):
    gaussians, binding, frames = make_case(generator, "cpu", count=5, faces=4)
    inputs = [tensor.double().requires_grad_() for tensor in (*gaussians, *frames)]
    # Away from quarter and half turns, where Shepperd's choice changes the sign of q'.
    inputs[4] = quaternion_to_rotation(
        torch.randn(4, 4, generator=generator, dtype=torch.float64)
    ).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda *inputs: tuple(reference(*inputs[:4], binding, TriangleFrames(*inputs[4:]))), inputs
    )


def test_twin_quaternions_by_matrices(generator):
    p, q = torch.nn.functional.normalize(
        torch.randn(2, 500, 4, generator=generator, dtype=torch.float64), dim=-1
    )
    product = quaternion_to_rotation(quaternion_product(p, q))
    assert torch.allclose(product, quaternion_to_rotation(p) @ quaternion_to_rotation(q), rtol=0, atol=1e-12)
    rotation = torch.cat([quaternion_to_rotation(p), make_frames(generator, "cpu", 8).rotation.double()])
    assert torch.allclose(
        quaternion_to_rotation(rotation_to_quaternion(rotation)), rotation, rtol=0, atol=1e-7
    )


def test_rotations_gradient_is_tangential(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    _, grads = with_gradients(bind, gaussians, binding, frames, make_weights(generator, device, 2000))
    grad, rotation = grads[4].double(), frames.rotation.double()
    assert (grad - tangent(grad, rotation)).norm() < 1e-6 * grad.norm()


def test_follows_rigid_motion(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    turn = quaternion_to_rotation(torch.tensor([[0.8, 0.3, -0.4, 0.2]], dtype=torch.float64))[0].to(device)
    shift = torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64, device=device)
    still = bind(*gaussians, binding, frames)
    moved_frames = TriangleFrames(
        (turn @ frames.rotation.double()).float(),
        (frames.translation.double() @ turn.T + shift).float(),
        frames.scale,
    )
    moved = bind(*gaussians, binding, moved_frames)
    assert torch.allclose(moved.means.double(), still.means.double() @ turn.T + shift, rtol=0, atol=1e-5)
    assert torch.allclose(moved.normals.double(), still.normals.double() @ turn.T, rtol=0, atol=2e-6)
    assert torch.equal(moved.scales, still.scales)
    expected = turn @ quaternion_to_rotation(still.quaternions.double())
    assert torch.allclose(quaternion_to_rotation(moved.quaternions.double()), expected, rtol=0, atol=5e-6)


def test_lengths_of_quaternions_and_normals_do_not_matter(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    means, quaternions, scales, normals = gaussians
    bound = bind(*gaussians, binding, frames)
    longer = bind(means, 4 * quaternions, scales, 0.25 * normals, binding, frames)
    assert torch.allclose(longer.quaternions, bound.quaternions, rtol=0, atol=1e-6)
    assert torch.allclose(longer.normals, bound.normals, rtol=0, atol=1e-6)


def test_zero_quaternion_and_zero_normal(device, generator):
    """A zero quaternion is the identity, a zero normal stays zero; neither has a gradient, and the rest is
    not disturbed."""
    gaussians, binding, frames = make_case(generator, device, count=40, faces=10)
    gaussians[1][0], gaussians[3][1] = 0, 0
    bound, grads = with_gradients(bind, gaussians, binding, frames, make_weights(generator, device, 40))
    expected = frames.rotation[binding.faces[0].long()].double()
    assert torch.allclose(
        quaternion_to_rotation(bound.quaternions[:1].double())[0], expected, rtol=0, atol=1e-6
    )
    assert not bound.normals[1].any()
    assert not grads[1][0].any()
    assert not grads[3][1].any()
    assert all(bool(tensor.isfinite().all()) for tensor in (*bound, *grads))


def test_order_of_gaussians_does_not_matter(device, generator):
    gaussians, binding, frames = make_case(generator, device)
    order = torch.randperm(2000, generator=generator).to(device)
    bound = bind(*gaussians, binding, frames)
    shuffled = bind(
        *(tensor[order] for tensor in gaussians),
        FaceBinding.build(binding.faces[order], binding.face_count),
        frames,
    )
    assert all(torch.equal(one[order], other) for one, other in zip(bound, shuffled, strict=True))


def test_same_bits_for_any_threads_and_runs(device, generator):
    gaussians, binding, frames = make_case(generator, device, count=9000, faces=4000)
    weights = make_weights(generator, device, 9000)
    leaves = [tensor.clone().requires_grad_() for tensor in (*gaussians, *frames)]
    before, runs = torch.get_num_threads(), []
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        bound = bind(*leaves[:4], binding, TriangleFrames(*leaves[4:]))
        first = torch.autograd.grad(bound, leaves, weights, retain_graph=True)
        second = torch.autograd.grad(bound, leaves, weights)
        assert all(torch.equal(one, two) for one, two in zip(first, second, strict=True))
        runs.append((*bound, *first))
    torch.set_num_threads(before)
    for run in runs[1:]:
        assert all(torch.equal(one, two) for one, two in zip(runs[0], run, strict=True))


def test_no_gaussians(device, generator):
    gaussians = make_gaussians(generator, device, 0)
    frames = make_frames(generator, device, 3)
    binding = FaceBinding.build(torch.empty(0, dtype=torch.int64, device=device), 3)
    bound, grads = with_gradients(bind, gaussians, binding, frames, make_weights(generator, device, 0))
    assert [tuple(part.shape) for part in bound] == [(0, 3), (0, 4), (0, 3), (0, 3)]
    assert not any(grad.any() for grad in grads)


def test_wrong_arguments_are_a_users_error(device, generator):
    gaussians, binding, frames = make_case(generator, device, count=20, faces=5)
    for index, name in enumerate(INPUTS):
        wrong = [tensor[1:] if place == index else tensor for place, tensor in enumerate(gaussians)]
        with pytest.raises(UserError, match=name):
            bind(*wrong, binding, frames)
    with pytest.raises(UserError, match="rotation"):
        bind(*gaussians, binding, frames._replace(rotation=frames.rotation[1:]))
    with pytest.raises(UserError, match="ids 0 to 4"):
        FaceBinding.build(torch.tensor([5], device=device), 5)
