"""Avatars and renderings in a notebook: what IPython shows of them."""

import io

import numpy as np
import pytest
import torch
from IPython.core.formatters import DisplayFormatter
from PIL import Image

from samira_warp.avatar import Avatar, read_frames
from samira_warp.avatar.portrait import portrait_camera
from samira_warp.io.images import to_uint8
from samira_warp.light import LearnableLight


@pytest.fixture(scope="module")
def avatar(tiny_run):
    return Avatar.load(tiny_run)


def shown(thing):
    """(H, W, 3) uint8: the picture that a notebook shows of something, which is a PNG."""
    data, _ = DisplayFormatter().format(thing)
    with Image.open(io.BytesIO(data["image/png"])) as image:
        assert (image.format, image.mode) == ("PNG", "RGB")
        return np.asarray(image)


def test_a_rendering_shows_its_image(avatar, tiny_run):
    frame = read_frames(tiny_run)[0]
    rendering = avatar.render(frame.parameters, frame.camera)
    assert rendering.image.requires_grad
    picture = shown(rendering)
    assert picture.shape == (frame.camera.height, frame.camera.width, 3)
    np.testing.assert_array_equal(picture, to_uint8(rendering.image.detach().numpy()))
    assert picture.std() > 20.0


def test_an_avatar_shows_its_face_at_rest_whole_and_upright(avatar):
    picture = shown(avatar)
    assert picture.shape == (256, 256, 3)
    head = (picture < 250).any(axis=2)
    assert not head[[0, -1]].any()
    assert not head[:, [0, -1]].any()
    # the head is where the vertices at rest are; Gaussians of a run of six steps reach past them by up to a
    # tenth of the side
    vertices = avatar.canonical.vertices
    points = portrait_camera(avatar.canonical).image_points(vertices)[:, :2].detach().numpy()
    ends = [
        [where.min(), where.max() + 1] for where in (np.flatnonzero(head.any(axis=axis)) for axis in (0, 1))
    ]
    np.testing.assert_allclose(ends, np.stack([points.min(axis=0), points.max(axis=0)], axis=1), atol=26.0)
    assert (points > 0).all()
    assert (points < 256).all()
    assert np.ptp(points, axis=0).max() > 0.6 * 256
    # the same from the same: nothing of it is left to chance
    np.testing.assert_array_equal(picture, shown(avatar))


def test_its_light_is_filtered_once_until_it_changes(tiny_run, monkeypatch):
    avatar, calls = Avatar.load(tiny_run), []
    filtered = LearnableLight.forward

    def counted(light):
        calls.append(light)
        return filtered(light)

    monkeypatch.setattr(LearnableLight, "forward", counted)
    before = shown(avatar)
    shown(avatar)
    assert len(calls) == 1
    with torch.no_grad():
        for parameter in avatar.light.parameters():
            parameter.sub_(0.5)
    after = shown(avatar)
    assert len(calls) == 2
    assert after.mean() < before.mean() - 1.0
