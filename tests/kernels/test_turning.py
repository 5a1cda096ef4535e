"""Turns of rotations: against their specification and scipy, and at the angles where series take over."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from samira_warp.kernels.mesh.turning import turn
from samira_warp.reference.mesh import turning as reference
from samira_warp.support.errors import UserError

ANGLES = [0.0, 1e-30, 1e-4, 0.0199, 0.0201, 0.5, 3.1]


def rotations(angle, generator, count=50):
    """Quaternions of several lengths, and turns by one angle about any axis."""
    axes = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    return 1.5 * torch.randn(count, 4, generator=generator), angle * axes


@pytest.mark.parametrize("angle", ANGLES)
def test_values_and_gradients_are_those_of_the_specification(angle, device, generator):
    ours = [values.to(device).requires_grad_() for values in rotations(angle, generator)]
    exact = [values.detach().double().requires_grad_() for values in ours]
    turned, truth = turn(*ours), reference.turn(*exact)
    # a product of quaternions up to 4 long: four products and sums of 2^-24 each
    torch.testing.assert_close(turned.double(), truth, rtol=0, atol=3e-6)
    weights = torch.randn(turned.shape, generator=generator).to(device)
    (weights * turned).sum().backward()
    (weights.double() * truth).sum().backward()
    # the slope of sin(a / 2) / a cancels: 2^-24 / a^2 at the least angle without its series, times a^2
    for mine, right in zip(ours, exact, strict=True):
        torch.testing.assert_close(mine.grad.double(), right.grad, rtol=0, atol=2e-5)


def test_a_turn_comes_after_the_rotation(device, generator):
    quaternions, turns = rotations(1.2, generator)
    turned = turn(quaternions.to(device), turns.to(device)).cpu()
    before = Rotation.from_quat(quaternions.numpy(), scalar_first=True)
    expected = (Rotation.from_rotvec(turns.numpy()) * before).as_matrix()
    found = Rotation.from_quat(turned.numpy(), scalar_first=True).as_matrix()
    # unit quaternions are off by a few 1e-7, matrices by twice that
    torch.testing.assert_close(torch.from_numpy(found), torch.from_numpy(expected), rtol=0, atol=5e-6)
    torch.testing.assert_close(turned.norm(dim=1), quaternions.norm(dim=1))


def test_no_turn_leaves_the_bits(device, generator):
    quaternions, _ = rotations(0.0, generator)
    assert torch.equal(turn(quaternions.to(device), torch.zeros(50, 3, device=device)).cpu(), quaternions)


def test_strided_inputs(device, generator):
    quaternions, turns = (values.to(device) for values in rotations(0.7, generator))
    apart = turn(quaternions.T.contiguous().T, torch.cat([turns, turns], dim=1)[:, :3])
    assert torch.equal(apart, turn(quaternions, turns))


def test_other_counts_are_refused():
    with pytest.raises(UserError, match="turns"):
        turn(torch.zeros(3, 4), torch.zeros(2, 3))
