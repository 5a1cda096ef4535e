"""A light that frames share: what it learns is the mean of what each of them would have taught it."""

import torch
from subjects import camera, parameters, small_avatar

from samira_warp.train.shared_light import SharedLight

FRAMES = range(3)


def objective(avatar, seed, light):
    """Some function of a frame's picture."""
    image = avatar.render(parameters(seed), camera(), light).image
    return (image * torch.linspace(0.0, 1.0 + seed, image.numel()).view_as(image)).mean()


def test_it_learns_the_mean_of_what_frames_teach():
    avatar = small_avatar(perturb=0.1)
    expected = [
        torch.autograd.grad(objective(avatar, seed, avatar.light()), list(avatar.light.parameters()))
        for seed in FRAMES
    ]
    shared = SharedLight(avatar.light)
    for seed in FRAMES:
        objective(avatar, seed, shared.light()).backward()
        assert all(parameter.grad is None for parameter in avatar.light.parameters())
        shared.listen()
    assert shared.frames == len(FRAMES)
    shared.learn()
    for parameter, *each in zip(avatar.light.parameters(), *expected, strict=True):
        mean = torch.stack(each).mean(dim=0)
        # sums of some thousand pixels' float32 in two orders
        error = (parameter.grad - mean).norm() / mean.norm()
        assert error < 1e-5
    assert shared.frames == 0
    assert not shared.gradient.any()


def test_it_is_filtered_once_and_again_when_it_has_learned():
    avatar = small_avatar()
    shared = SharedLight(avatar.light)
    seen = shared.light()
    assert shared.light() is seen
    assert all(
        torch.equal(ours, own) for ours, own in zip(seen.specular, avatar.light().specular, strict=True)
    )
    shared.listen()
    shared.learn()
    with torch.no_grad():
        avatar.light.specular += 0.5
    brighter = shared.light()
    assert (brighter.irradiance > seen.irradiance).all() or avatar.light.diffuse is not None
    assert (brighter.specular[1] > seen.specular[1]).all()


def test_a_light_that_rests_can_still_be_listened_for():
    """Between its steps its parameters want no gradients, and what comes later still reaches them."""
    avatar = small_avatar()
    avatar.light.requires_grad_(False)
    shared = SharedLight(avatar.light)
    objective(avatar, 0, shared.light()).backward()
    shared.listen()
    avatar.light.requires_grad_()
    shared.learn()
    assert avatar.light.specular.grad.any()
