"""The tracker's noise is what its trajectory shows, and the network alone sees more of it."""

import numpy as np
import pytest
import torch
from subjects import parameters, small_avatar

from samira_warp.head import FrameParameters
from samira_warp.train.jitter import jittered, tracking_noise

FRAMES = 600


def tracked(generator, noise):
    """A smooth motion of FRAMES frames with white noise on it, a standard deviation for each kind."""
    time = torch.arange(FRAMES)[:, None] / 25.0
    frame = parameters(0)
    batch = FrameParameters.stack([frame] * FRAMES)
    for name, deviation in noise.items():
        values = getattr(batch, name)
        rates = 0.3 + torch.rand(values[0].numel(), generator=generator)
        smooth = 0.1 * torch.sin(rates * time).view(values.shape)
        values.copy_(smooth + deviation * torch.randn(values.shape, generator=generator))
    return batch


def test_white_noise_on_a_smooth_motion_is_measured(generator):
    truth = {"translation": 2e-4, "rotations": 2e-3, "expression": 0.02}
    found = tracking_noise(tracked(generator, truth), range(FRAMES))
    for name, deviation in truth.items():
        assert found[name].shape == getattr(parameters(0), name).shape
        # the median of 600 sizes has a relative deviation of 1.17 / sqrt(600) = 5 %, and more as second
        # differences overlap; a smooth motion bends by 0.1 (1.3 / 25)^2 = 3e-4 at most a frame
        assert found[name].mean() == pytest.approx(deviation, rel=0.25 if name == "translation" else 0.1)


def test_an_exact_smooth_track_has_next_to_none(generator):
    still = {"translation": 0.0, "rotations": 0.0, "expression": 0.0}
    found = tracking_noise(tracked(generator, still), range(FRAMES))
    # 3e-4 over 6^0.5 and the median's share
    assert all(values.max() < 2e-4 for values in found.values())


def test_only_three_moments_in_a_row_are_compared(generator):
    noise = {"translation": 0.0, "rotations": 1e-3, "expression": 0.0}
    batch = tracked(generator, noise)
    apart = tracking_noise(batch, range(0, 2 * FRAMES, 2))
    assert all((values == 0).all() for values in apart.values())
    order = torch.from_numpy(np.random.default_rng(0).permutation(FRAMES))
    shuffled = FrameParameters(batch.translation[order], batch.rotations[order], batch.expression[order])
    found, expected = tracking_noise(shuffled, order.tolist()), tracking_noise(batch, range(FRAMES))
    assert all(torch.equal(found[name], expected[name]) for name in expected)


def test_what_is_drawn_has_the_noise_asked_for(generator):
    frame = parameters(1)
    noise = {"translation": torch.tensor([1e-3, 2e-3, 0.0])}
    drawn = torch.stack([jittered(frame, noise, generator=generator).translation for _ in range(2000)])
    # 2,000 draws: a relative deviation of 1 / sqrt(4000)
    torch.testing.assert_close(
        (drawn - frame.translation).std(dim=0), noise["translation"], rtol=0.06, atol=1e-9
    )
    assert torch.equal(jittered(frame, noise, generator=generator).expression, frame.expression)


def test_the_mesh_stays_where_it_was_tracked():
    avatar = small_avatar(perturb=0.5)
    frame, seen = parameters(1), parameters(2)
    with torch.no_grad():
        plain, other, elsewhere = avatar.move(frame), avatar.move(frame, seen=seen), avatar.move(seen)
    assert torch.equal(other.head.vertices, plain.head.vertices)
    assert torch.equal(other.residual_position, elsewhere.residual_position)
    assert not torch.equal(other.residual_position, plain.residual_position)
