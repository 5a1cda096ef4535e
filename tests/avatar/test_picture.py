"""Pictures that nobody differentiates against those that somebody does."""

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.light import Environment
from samira_warp.support.errors import UserError

SIDE = 40

ROUNDING = 5e-6
"""Directions are some 1e-6 apart (`test_aiming`); a light of 16 texels a face changes by less than its own
brightness over a texel, an eighth of a radian, and its display values by at most four times that near black,
where the curve is steep and light is dim."""


@pytest.fixture(scope="module")
def avatar():
    return small_avatar(perturb=0.1)


@pytest.fixture(scope="module")
def light():
    cubemap = torch.rand(6, 16, 16, 3, generator=torch.Generator().manual_seed(2)) + 0.1
    return Environment.from_cubemaps(cubemap, cubemap).filtered().turned(40.0).exposed(1.5)


@pytest.fixture(scope="module", params=["white", "grey pixels"])
def background(request):
    if request.param == "white":
        return 1.0
    return torch.rand(SIDE, SIDE, 3, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("tone_map", ["none", "filmic"])
def test_a_picture_is_the_one_that_is_differentiated(avatar, light, background, tone_map):
    arguments = (parameters(3), camera(SIDE), light)
    wanted = avatar.render(*arguments, background=background, tone_map=tone_map)
    with torch.no_grad():
        found = avatar.render(*arguments, background=background, tone_map=tone_map)
    bare = wanted.gbuffer.alpha[..., 0] == 0.0
    assert bare.any()
    assert not bare.all()
    for name in ("image", "radiance", "irradiance", "specular_light"):
        torch.testing.assert_close(
            getattr(found, name), getattr(wanted, name).detach(), rtol=ROUNDING, atol=ROUNDING, msg=name
        )
    assert torch.equal(found.image[bare], wanted.image[bare].detach())


def test_image_values_are_not_bent(light):
    raw = small_avatar(color_space="raw")
    with torch.no_grad(), pytest.raises(UserError, match="image values"):
        raw.render(parameters(3), camera(SIDE), light, tone_map="filmic")
