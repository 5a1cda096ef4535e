import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from samira_warp.avatar.residual import POSITION_LIMIT, limit_residual, quaternion_product
from samira_warp.reference.mesh.turning import SMALL_ANGLE, axis_angle_to_quaternion

ANGLES = [
    0.0,
    1e-12,
    0.5 * SMALL_ANGLE,
    0.999 * SMALL_ANGLE,
    1.001 * SMALL_ANGLE,
    0.1,
    1.0,
    3.0,
    math.pi * 0.999,
]


def vectors(angle, generator, count=8):
    axes = torch.nn.functional.normalize(
        torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1
    )
    return angle * axes


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_are_those_of_the_rotation_vectors(angle, device, generator):
    axis_angle = vectors(angle, generator)
    expected = torch.from_numpy(Rotation.from_rotvec(axis_angle.numpy()).as_quat(scalar_first=True))
    # the series leaves out angle^4 / 384 = 3e-19 at the switch: nothing but float64's rounding remains
    torch.testing.assert_close(
        axis_angle_to_quaternion(axis_angle.to(device)).cpu(), expected, atol=1e-15, rtol=0
    )
    # float32: a few roundings of numbers up to 1
    torch.testing.assert_close(
        axis_angle_to_quaternion(axis_angle.float().to(device)).cpu().double(), expected, atol=5e-7, rtol=0
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_gradient_by_finite_differences(angle, generator):
    # the step of 1e-6 straddles the switch between series and closed form at SMALL_ANGLE, where the two agree
    # to 1e-15
    assert torch.autograd.gradcheck(
        axis_angle_to_quaternion, vectors(angle, generator).requires_grad_(), eps=1e-6, atol=1e-8
    )


def test_gradient_at_zero_is_half_the_identity(device):
    axis_angle = torch.zeros(3, device=device)
    jacobian = torch.autograd.functional.jacobian(axis_angle_to_quaternion, axis_angle)
    assert torch.equal(jacobian[1:], 0.5 * torch.eye(3, device=device))
    assert (jacobian[0] == 0).all()


@pytest.mark.parametrize("length", [1e-30, 1e-38, 1e-45])
def test_float32_gradient_is_finite_where_the_square_underflows(length, device):
    axis_angle = torch.full((4, 3), length, device=device, requires_grad=True)
    axis_angle_to_quaternion(axis_angle).sum().backward()
    torch.testing.assert_close(axis_angle.grad, torch.full_like(axis_angle, 0.5))


def test_product_turns_by_the_right_one_first(device, generator):
    left, right = vectors(1.1, generator), vectors(2.3, generator)
    expected = (Rotation.from_rotvec(left.numpy()) * Rotation.from_rotvec(right.numpy())).as_matrix()
    product = quaternion_product(
        axis_angle_to_quaternion(left.to(device)), axis_angle_to_quaternion(right.to(device))
    ).cpu()
    actual = Rotation.from_quat(product.numpy(), scalar_first=True).as_matrix()
    torch.testing.assert_close(torch.from_numpy(actual), torch.from_numpy(expected), atol=1e-14, rtol=0)
    torch.testing.assert_close(product.norm(dim=1), torch.ones(8, dtype=torch.float64), atol=1e-14, rtol=0)


def test_limits(device, generator):
    residual = (3.0 * torch.randn(7, 6, generator=generator, dtype=torch.float64)).to(device)
    position, rotation, none = limit_residual(residual)
    assert none.shape == (7, 0)
    assert POSITION_LIMIT == 0.02
    torch.testing.assert_close(position, 0.02 * torch.tanh(residual[:, :3]))
    torch.testing.assert_close(rotation, math.pi * torch.tanh(residual[:, 3:]))
    extreme = limit_residual(torch.full((1, 6), 1e30, device=device))
    assert (extreme[0] <= 0.02).all()
    assert extreme[1].isfinite().all()
    at_rest = limit_residual(torch.zeros(2, 8, device=device))
    assert at_rest.slopes.shape == (2, 2)
    assert all((part == 0).all() for part in at_rest)
