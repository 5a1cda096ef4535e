import math

import pytest
import torch
from subjects import small_avatar

from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.train.limits import AXIS_LIMIT, AXIS_LONGEST, AXIS_RATIO, REACH, hold_shapes, longest_axes

ROUNDING = 1 + 1e-5
"""Of a logarithm in float32, taken and undone."""


@pytest.fixture
def held(device):
    """Gaussians far away and of any shape, before and after; and their triangles' scales."""
    avatar = small_avatar(gaussians=300, device=device)
    generator = torch.Generator().manual_seed(0)
    gaussians, canonical = avatar.gaussians, avatar.canonical
    with torch.no_grad():
        gaussians.means.copy_((2.0 * torch.randn(300, 3, generator=generator)).to(device))
        gaussians.log_scales.add_((2.0 * torch.randn(300, 3, generator=generator)).to(device))
    before = gaussians.tensors() | {"means": gaussians.means.detach().clone()}
    before["log_scales"] = before["log_scales"].clone()
    scales = triangle_frames(canonical.vertices, canonical.topology).scale
    hold_shapes(gaussians, scales, longest_axes(scales, torch.zeros_like(scales)))
    return gaussians, before, scales[gaussians.faces.long()]


def test_nothing_is_beyond_the_limits(held):
    gaussians, before, face_scales = held
    longest, shortest = gaussians.scales.amax(dim=1), gaussians.scales.amin(dim=1)
    assert gaussians.means.norm(dim=1).max() <= REACH * ROUNDING
    assert longest.max() <= AXIS_LIMIT * ROUNDING
    assert (longest * face_scales).max() <= AXIS_LONGEST * ROUNDING
    assert (longest / shortest).max() <= AXIS_RATIO * ROUNDING
    reached = (before["means"].norm(dim=1) > REACH).sum(), (before["log_scales"] > math.log(AXIS_LIMIT)).sum()
    assert min(reached) > 20


def test_what_is_within_them_stays_as_it_is(held):
    gaussians, before, face_scales = held
    near = before["means"].norm(dim=1) <= REACH
    assert near.any()
    assert torch.equal(gaussians.means[near], before["means"][near])
    scales = before["log_scales"].exp()
    limit = (AXIS_LONGEST / face_scales).clamp(max=AXIS_LIMIT)
    longest = scales.amax(dim=1)
    fits = (longest <= limit / ROUNDING) & (longest / scales.amin(dim=1) <= AXIS_RATIO / ROUNDING)
    assert fits.any()
    assert torch.equal(gaussians.log_scales[fits], before["log_scales"][fits])


def test_directions_are_kept(held):
    gaussians, before, _ = held
    unit = torch.nn.functional.normalize
    torch.testing.assert_close(unit(gaussians.means), unit(before["means"]), rtol=0, atol=1e-6)


def test_few_gaussians_reach_beyond_their_triangles():
    """A hundred on a head of thousands of triangles would leave holes otherwise."""
    scales, spread = torch.tensor([0.001, 0.002, 0.02]), torch.tensor([0.003, 0.001, 0.001])
    torch.testing.assert_close(longest_axes(scales, spread), torch.tensor([0.003, 0.0016, AXIS_LONGEST]))
