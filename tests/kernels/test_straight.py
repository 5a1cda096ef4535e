"""Straight surfaces: against their specification, in values and gradients, and what they are for."""

import pytest
import torch

from samira_warp.kernels.raster.straight import straighten
from samira_warp.reference.raster import straight as reference
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, LIGHT_CHANNELS, LIGHT_WIDTH, SURFACE_WIDTH

WIDTHS = {"unlit": SURFACE_WIDTH + 1, "lit": SURFACE_WIDTH + LIGHT_WIDTH + 1}

ROUNDING = 1e-5
"""Relative: sixteen products and sums of float32, some 6e-8 each, with room for cancellation in the normal's
adjoint."""


def pixels(width, device):
    """Sums and coverage of 9 x 7 pixels: some bare, one just covered, one below the least coverage."""
    generator = torch.Generator().manual_seed(0)
    alpha = torch.rand(9, 7, generator=generator) * 0.9 + 0.1
    sums = torch.randn(9, 7, width, generator=generator) * alpha[..., None]
    alpha[0], sums[0] = 0.0, 0.0
    alpha[1, 0], alpha[1, 1] = COVERED_ALPHA, 0.5 * COVERED_ALPHA
    return sums.to(device), alpha.to(device)


@pytest.mark.parametrize("width", WIDTHS.values(), ids=list(WIDTHS))
def test_values_and_gradients_are_those_of_the_specification(width, device):
    sums, alpha = (values.requires_grad_() for values in pixels(width, device))
    exact = [values.detach().double().requires_grad_() for values in (sums, alpha)]
    ours, theirs = straighten(sums, alpha), reference.straighten(*exact)
    outputs = [*ours.surface.channels().values(), ours.depth]
    truths = [*theirs.surface.channels().values(), theirs.depth]
    for name, output, truth in zip([*CHANNELS, "depth"], outputs, truths, strict=True):
        torch.testing.assert_close(
            output.double(), truth, rtol=ROUNDING, atol=ROUNDING, msg=lambda m, n=name: f"{n}: {m}"
        )
    generator = torch.Generator().manual_seed(1)
    weights = [torch.randn(output.shape, generator=generator).to(device) for output in outputs]
    sum((w * o).sum() for w, o in zip(weights, outputs, strict=True)).backward()
    sum((w.double() * o).sum() for w, o in zip(weights, truths, strict=True)).backward()
    # where sums of no coverage are divided by 1/255, gradients are 255 times as large
    for mine, right in zip((sums, alpha), exact, strict=True):
        torch.testing.assert_close(mine.grad.double(), right.grad, rtol=1e-4, atol=255 * ROUNDING)


def test_a_covered_pixel_shows_what_was_blended_into_it(device):
    """Closed form: one surface, blended at any coverage, is that surface."""
    surface = torch.arange(1.0, SURFACE_WIDTH + LIGHT_WIDTH + 2, device=device)
    alpha = torch.tensor([[0.25, 0.5, 1.0]], device=device)
    straight = straighten(alpha[..., None] * surface, alpha)
    # powers of two: nothing is rounded
    assert torch.equal(straight.surface.albedo, surface[:3].expand(1, 3, 3))
    assert torch.equal(straight.surface.ambient_occlusion, surface[14].expand(1, 3, 1))
    assert torch.equal(straight.depth, surface[15].expand(1, 3, 1))
    unit = surface[3:6] / surface[3:6].norm()
    torch.testing.assert_close(straight.surface.normal, unit.expand(1, 3, 3))


def test_a_bare_pixel_has_no_direction_and_meets_the_whole_light(device):
    straight = straighten(torch.zeros(1, 1, WIDTHS["lit"], device=device), torch.zeros(1, 1, device=device))
    assert not straight.surface.normal.any()
    assert all((getattr(straight.surface, name) == 1.0).all() for name in LIGHT_CHANNELS)


def test_a_direction_does_not_depend_on_coverage(device):
    sums, alpha = pixels(WIDTHS["lit"], device)
    alpha.requires_grad_()
    straighten(sums, alpha).surface.normal.square().sum().backward()
    assert not alpha.grad.any()


def test_other_channels_are_refused():
    with pytest.raises(UserError, match="11 channels, or 16 with light"):
        straighten(torch.zeros(2, 2, 12), torch.zeros(2, 2))
