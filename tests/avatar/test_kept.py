"""What an avatar keeps from frame to frame where nobody asks for gradients: what it would make anew."""

import pytest
import torch
from subjects import parameters, small_avatar

from samira_warp.nets import MotionSettings


@pytest.fixture
def avatar():
    # with wrinkles, so that all of the network's output is looked at
    made = small_avatar(perturb=0.3, motion=MotionSettings(width=8, region_width=4, wrinkles=True))
    with torch.no_grad():
        made.response_logits.normal_(generator=torch.Generator().manual_seed(4))
    return made


def shown(avatar):
    """The motion network's map and the surface of a frame."""
    motion = avatar.move(parameters(1))
    return motion.residual, *avatar.surface(motion).channels().values()


def weights_stepped(avatar):
    for part in (avatar.motion.position, avatar.motion.lateral):
        for weight in part.parameters():
            weight.grad = torch.ones_like(weight)
    avatar.motion.gates.grad = torch.ones_like(avatar.motion.gates)
    avatar.response_logits.grad = torch.ones_like(avatar.response_logits)
    torch.optim.Adam(avatar.parameters(), lr=0.1, fused=True).step()  # as in training
    return avatar


def state_loaded(avatar):
    other = small_avatar(perturb=0.7, motion=avatar.settings.motion)
    weights_stepped(other)
    avatar.load_state_dict(other.state_dict())
    return avatar


def state_assigned(avatar):
    other = small_avatar(perturb=0.7, motion=avatar.settings.motion)
    weights_stepped(other)
    avatar.load_state_dict(other.state_dict(), assign=True)
    return avatar


def gaussians_moved(avatar):
    gaussians = avatar.gaussians
    gaussians.uv.copy_(gaussians.uv.roll(1, dims=0))
    gaussians.faces.copy_(gaussians.faces.roll(1, dims=0))
    avatar.set_gaussians(gaussians)
    return avatar


@pytest.mark.parametrize("change", [weights_stepped, state_loaded, state_assigned, gaussians_moved])
def test_a_change_is_seen_as_by_one_who_asks_for_gradients(avatar, change):
    with torch.no_grad():
        before = shown(avatar)
        again = shown(avatar)
    avatar = change(avatar)
    wanted = shown(avatar)
    with torch.no_grad():
        found = shown(avatar)
    assert all(torch.equal(one, other) for one, other in zip(before, again, strict=True))
    assert all(torch.equal(one, other.detach()) for one, other in zip(found, wanted, strict=True))
    assert any(not torch.equal(one, other) for one, other in zip(found, before, strict=True))


def test_what_was_kept_carries_no_gradient_away(avatar):
    """Gradients after a picture that was only looked at are those without it."""

    def gradients():
        avatar.zero_grad()
        sum(values.square().sum() for values in shown(avatar)).backward()
        return [weight.grad.clone() for weight in avatar.parameters() if weight.grad is not None]

    alone = gradients()
    for mode in (torch.no_grad, torch.inference_mode):
        with mode():
            shown(avatar)
        assert all(torch.equal(one, other) for one, other in zip(gradients(), alone, strict=True))


def test_nothing_is_made_twice_of_the_same_weights(avatar, monkeypatch):
    made = []
    for owner, name in ((avatar, "_respond"), (avatar.motion, "_condition_nothing")):
        method = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda _m=method, _n=name: made.append(_n) or _m())
    with torch.no_grad():
        for _ in range(3):
            shown(avatar)
    assert sorted(made) == ["_condition_nothing", "_respond"]


def test_maps_of_the_residual_are_made_when_they_are_asked_for(avatar):
    motion = avatar.move(parameters(1))
    limit = 0.02 * torch.tanh(motion.residual[..., :3])
    assert torch.equal(motion.residual_position, limit)
    assert motion.residual_rotation.abs().max() <= torch.pi
    assert torch.equal(motion.slopes, torch.tanh(motion.residual[..., 6:]))
