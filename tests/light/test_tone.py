"""The filmic curve, and that whoever shows radiance by it shows all of it."""

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.light import compose, encode_srgb, filmic, to_display
from samira_warp.support.errors import UserError


def test_the_curve_is_the_published_one_at_the_exposure_of_aces():
    x = torch.linspace(0.0, 30.0, 3001, dtype=torch.float64)
    z = 0.6 * x
    published = (z * (2.51 * z + 0.03)) / (z * (2.43 * z + 0.59) + 0.14)
    torch.testing.assert_close(filmic(x), published.clamp(0.0, 1.0), atol=1e-15, rtol=0)
    # what its docstring says of it, rounded to two digits
    said = filmic(torch.tensor([-1.0, 0.0, 0.18, 0.4, 1.0, 12.1, 1e6]))
    assert [round(value, 2) for value in said.tolist()] == [0.0, 0.0, 0.14, 0.36, 0.67, 1.0, 1.0]


def test_it_rises_up_to_white():
    shown = filmic(torch.linspace(0.0, 12.0, 10_000, dtype=torch.float64))
    assert (shown.diff() > 0).all()
    assert shown[-1] < 1.0


def test_radiance_is_mapped_before_it_is_encoded_and_laid_on_the_background():
    radiance, alpha = torch.tensor([[0.1, 1.0, 9.0]]), torch.tensor([[0.25]])
    shown = encode_srgb(filmic(radiance))
    assert torch.equal(to_display(radiance, color_space="srgb", tone_map="filmic"), shown)
    assert torch.equal(compose(radiance, alpha, 0.5, tone_map="filmic"), 0.25 * shown + 0.375)


def test_image_values_have_no_tone_map():
    with pytest.raises(UserError, match="tone_map: expected none where shading works in image values"):
        to_display(torch.ones(3), color_space="raw", tone_map="filmic")
    with pytest.raises(UserError, match="tone_map"):
        small_avatar(color_space="raw").render(parameters(0), camera(16), tone_map="filmic")


def test_a_rendering_is_its_foreground_on_its_background():
    avatar, behind = small_avatar().requires_grad_(False), torch.tensor([0.2, 0.5, 0.9])
    plain = avatar.render(parameters(0), camera(32), background=behind)
    mapped = avatar.render(parameters(0), camera(32), background=behind, tone_map="filmic")
    assert torch.equal(plain.radiance, mapped.radiance)
    alpha = plain.gbuffer.alpha
    for rendering, foreground in [
        (plain, encode_srgb(plain.radiance)),
        (mapped, encode_srgb(filmic(plain.radiance))),
    ]:
        assert torch.equal(rendering.foreground, foreground)
        # the kernel and torch encode by powers of their own, which round differently
        laid = alpha * foreground + (1 - alpha) * behind
        torch.testing.assert_close(rendering.image, laid, atol=1e-6, rtol=1e-6)
    # where next to nothing is, the head adds nothing
    bare = alpha[..., 0] < 1 / 255
    assert bare.any()
    assert (plain.radiance[bare] == 0).all()
