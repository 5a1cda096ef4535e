"""What `Avatar.render` takes for a light and for a background."""

import numpy as np
import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.light import Environment, encode_srgb
from samira_warp.light.equirect import equirect_directions
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError

SIZE = 32


@pytest.fixture(scope="module")
def avatar():
    return small_avatar().requires_grad_(False)


@pytest.fixture(scope="module")
def environment(avatar):
    """A light that grows brighter towards the camera's right, seen as a panorama of it."""
    panorama = 0.6 + 0.4 * equirect_directions(32)[..., :1].expand(-1, -1, 3).contiguous()
    light = Environment.from_cubemaps(*(RadianceMap(panorama).to_cube(size) for size in (16, 32)))
    return Environment(light.diffuse, light.specular, RadianceMap(panorama))


def render(avatar, *arguments, **options):
    return avatar.render(parameters(0), camera(SIZE), *arguments, **options)


def test_a_light_is_moved_to_the_avatar_before_it_is_filtered(avatar, environment, monkeypatch):
    """Filtering is the longest part of such a frame, and belongs where the avatar is."""
    calls = []
    for name in ("to", "filtered"):
        method = getattr(Environment, name)
        monkeypatch.setattr(
            Environment,
            name,
            lambda self, *args, name=name, method=method: calls.append(name) or method(self, *args),
        )
    render(avatar, environment)
    assert calls == ["to", "filtered"]


def test_a_light_is_filtered_on_the_avatars_device(device, environment, monkeypatch):
    devices, filtered = [], Environment.filtered
    monkeypatch.setattr(
        Environment, "filtered", lambda self: devices.append(self.diffuse.device.type) or filtered(self)
    )
    with torch.no_grad():
        rendering = render(small_avatar(device=device), environment)
    assert devices == [device.type] == [rendering.image.device.type]


def test_a_light_is_turned_and_exposed_before_or_after_it_is_filtered(avatar, environment):
    plain = render(avatar, environment)
    moved = render(avatar, environment.turned(100.0).exposed(3.0))
    after = render(avatar, environment.filtered().turned(100.0).exposed(3.0))
    for name in ("image", "irradiance", "specular_light"):
        assert torch.equal(getattr(moved, name), getattr(after, name)), name
        assert not torch.allclose(getattr(moved, name), getattr(plain, name), atol=0.01), name
    exposed = render(avatar, environment.exposed(3.0))
    for name in ("irradiance", "specular_light"):
        # a product more, and one rounding of it
        torch.testing.assert_close(getattr(exposed, name), 3.0 * getattr(plain, name), rtol=1e-6, atol=1e-7)
    # materials are not the light's
    assert torch.equal(moved.gbuffer.response_diffuse, plain.gbuffer.response_diffuse)
    assert torch.equal(moved.gbuffer.normal, plain.gbuffer.normal)


def test_the_background_of_an_environment_is_one_to_render_with(avatar, environment):
    turned = environment.turned(90.0)
    background = turned.background(camera(SIZE), color_space=avatar.settings.color_space)
    rendering = render(avatar, turned, background=background)
    outside = rendering.gbuffer.alpha[..., 0] == 0
    assert outside.sum() > 100
    assert torch.equal(rendering.image[outside], background[outside])
    # turned by a quarter, the camera looks at what was on its right: radiance 1, less at the view's sides
    assert background.min() > encode_srgb(torch.tensor(0.98))
    assert background.max() <= 1.0


@pytest.mark.parametrize(
    "background", [0, 0.25, True, torch.tensor([0.1, 0.2, 0.3]), torch.rand(SIZE, SIZE, 3)]
)
def test_a_background_is_a_number_a_colour_or_a_picture(avatar, background):
    with torch.no_grad():
        rendering = render(avatar, background=background)
    outside = rendering.gbuffer.alpha[..., 0] == 0
    expected = torch.as_tensor(background, dtype=torch.float32).expand(SIZE, SIZE, 3)
    assert torch.equal(rendering.image[outside], expected[outside])


@pytest.mark.parametrize(
    ("background", "found"),
    [
        (torch.ones(SIZE, SIZE, 1), r"float32 \(32, 32, 1\)"),
        (torch.ones(16, 16, 3), r"float32 \(16, 16, 3\)"),
        (torch.ones(SIZE, SIZE), r"float32 \(32, 32\)"),
        (torch.ones(4), r"float32 \(4,\)"),
        (torch.ones(1, 1, 3), r"float32 \(1, 1, 3\)"),
        (torch.tensor(0.5), r"float32 \(\)"),
        (torch.ones(SIZE, SIZE, 3, dtype=torch.float64), r"float64 \(32, 32, 3\)"),
        (torch.ones(3, dtype=torch.uint8), r"uint8 \(3,\)"),
        (np.ones((SIZE, SIZE, 3), np.float32), "ndarray"),
        ("white", "str"),
        (None, "NoneType"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_any_other_background_is_refused_by_name(avatar, background, found):
    expected = r"^background: expected a number, or float32 \(3,\) or \(32, 32, 3\) on cpu, found " + found
    with pytest.raises(UserError, match=expected):
        render(avatar, background=background)
