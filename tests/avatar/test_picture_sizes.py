"""What a picture averages to does not depend on its size."""

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.support.constants import SMOOTHING

SIZE = 64


@pytest.fixture
def pictures(device):
    """By size: the same view of a head whose albedo is noise."""
    smoothing = SMOOTHING**0.5 / camera(SIZE).fx
    avatar = small_avatar(gaussians=6000, smoothing=smoothing, device=device)
    frame = parameters(0, turn=0.1, device=device)
    with torch.no_grad():
        views = {times: camera(times * SIZE, device=device) for times in (1, 2, 4)}
        return {times: avatar.render(frame, view).image for times, view in views.items()}


def brought_down(image, times):
    return torch.nn.functional.avg_pool2d(image.permute(2, 0, 1), times).permute(1, 2, 0)


@pytest.mark.parametrize("times", [2, 4])
def test_larger_pictures_average_to_the_training_size(pictures, times):
    error = (brought_down(pictures[times], times) - pictures[1]).square().mean()
    # 40 dB is one in a hundred: half of what the low-pass of 1/10 is off from the pixel's square of 1/12
    assert float(-10 * error.log10()) > 40.0
    assert float(pictures[1].std()) > 0.1


def test_what_is_seen_through_is_seen_through_at_any_size(device):
    """One small Gaussian's coverage, summed over the head, is the same at all sizes."""
    avatar = small_avatar(gaussians=3, residual=False, smoothing=1e-3, device=device)
    with torch.no_grad():
        avatar.gaussians.opacity_logits.fill_(-2.0)
    frame = parameters(0, turn=0.0, device=device)
    sums = []
    for times in (1, 2, 4):
        view = camera(times * SIZE, device=device)
        with torch.no_grad():
            alpha = avatar.rasterize(avatar.move(frame), view).alpha
        sums.append(float(alpha.sum()) / times**2)
    # ALPHA_MIN cuts off a Gaussian's tail: of a peak of 0.1 one part in thirty
    assert sums[1] == pytest.approx(sums[0], rel=0.05)
    assert sums[2] == pytest.approx(sums[0], rel=0.05)
