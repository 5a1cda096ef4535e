from dataclasses import fields

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.avatar import MaterialEdit
from samira_warp.avatar.editing import edit_materials
from samira_warp.head import REGIONS
from samira_warp.light import decode_srgb
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, Surface

COUNT = 50


@pytest.fixture
def surface(generator, device):
    return Surface(
        **{
            name: torch.rand(COUNT, channel.width, generator=generator).to(device)
            for name, channel in CHANNELS.items()
        }
    )


def test_an_edit_names_the_channels_that_may_be_edited():
    editable = {name for name, channel in CHANNELS.items() if channel.edited is not None}
    assert {field.name for field in fields(MaterialEdit)} == {*editable, "regions"}


@pytest.fixture
def weights(generator, device):
    return torch.softmax(torch.randn(COUNT, len(REGIONS), generator=generator), dim=1).to(device)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("roughness", "x0.5", lambda x: 0.5 * x),
        ("roughness", "0.25", lambda x: torch.full_like(x, 0.25)),
        ("specular", "x2", lambda x: (2 * x).clamp(max=1)),
        ("specular", "0", torch.zeros_like),
        ("albedo", "x1.2", lambda x: (1.2 * x).clamp(max=1)),
        ("albedo", "1.5,1,0", lambda x: (x * torch.tensor([1.5, 1.0, 0.0], device=x.device)).clamp(max=1)),
        (
            "albedo",
            "#8000FF",
            lambda x: decode_srgb(torch.tensor([128, 0, 255], device=x.device) / 255).expand_as(x),
        ),
    ],
)
def test_each_change(surface, weights, name, text, expected):
    edited = edit_materials(surface, [MaterialEdit(**{name: text})], weights, color_space="srgb")
    for field in CHANNELS:
        before = getattr(surface, field)
        torch.testing.assert_close(getattr(edited, field), expected(before) if field == name else before)


def test_a_colour_is_as_it_is_where_shading_works_in_image_values(surface, weights):
    edited = edit_materials(surface, [MaterialEdit(albedo="#336699")], weights, color_space="raw")
    torch.testing.assert_close(
        edited.albedo, torch.tensor([0.2, 0.4, 0.6], device=weights.device).expand(COUNT, 3)
    )


def test_regions_weigh_the_change(surface, weights):
    edit = MaterialEdit(roughness="1", regions=("nose", "scalp", "nose"))
    edited = edit_materials(surface, [edit], weights, color_space="srgb")
    share = weights[:, [REGIONS.index("nose"), REGIONS.index("scalp")]].sum(dim=1, keepdim=True)
    torch.testing.assert_close(edited.roughness, surface.roughness + share * (1 - surface.roughness))


def test_edits_follow_one_another(surface, weights):
    edits = [MaterialEdit(roughness="0.5"), MaterialEdit(roughness="x0.5", specular="x0")]
    edited = edit_materials(surface, edits, weights, color_space="srgb")
    torch.testing.assert_close(edited.roughness, torch.full_like(surface.roughness, 0.25))
    assert (edited.specular == 0).all()


@pytest.mark.parametrize("change", ["", "x", "0.5x", "-0.1", "1.1", "xnan", "nan", "x-2"])
def test_what_is_no_change_is_refused(change):
    with pytest.raises(UserError, match="roughness: expected a factor"):
        MaterialEdit(roughness=change)


@pytest.mark.parametrize(
    "change", ["", "0.5", "red", "#fff", "#12345g", "1,2", "1,2,3,4", "1,-2,3", "x1,1,1"]
)
def test_what_is_no_albedo_is_refused(change):
    with pytest.raises(UserError, match="albedo: expected a colour"):
        MaterialEdit(albedo=change)


def test_an_unknown_region_is_refused_with_those_there_are():
    with pytest.raises(UserError, match=r"forehead, left_eye.*'hair'"):
        MaterialEdit(albedo="x2", regions=("hair",))


def test_an_edited_picture_differs_in_its_region_alone(device):
    avatar = small_avatar(device=device, gaussians=600)
    frame, view = parameters(0, turn=0.0, device=device), camera(48, device=device)
    with torch.no_grad():
        before = avatar.render(frame, view)
        after = avatar.render(frame, view, edits=[MaterialEdit(albedo="#000000", regions=("forehead",))])
        weights = avatar.region_weights()
    darker = (before.image - after.image).amax(dim=-1)
    rows = torch.arange(48, device=device)[:, None].expand(48, 48)[darker > 0.1].float()
    # the forehead is above the middle of the picture
    assert len(rows) > 30
    assert rows.max() < 24
    assert torch.equal(before.gbuffer.roughness, after.gbuffer.roughness)
    assert torch.equal(avatar.render(frame, view).image, before.image)
    torch.testing.assert_close(weights.sum(dim=1), torch.ones(len(weights), device=device))
