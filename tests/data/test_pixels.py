"""Frames as they are trained on: laid on white, with their coverage, at the size asked for."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from samira_warp.data import open_listing
from samira_warp.data.pixels import load_mask, load_pixels, on_white
from samira_warp.io.images import read_image, resize_box, write_png
from samira_warp.support.errors import UserError

SIZE = {"width": 32, "height": 32}
COLOUR = np.array([0.8, 0.4, 0.2])
# half of the 256 levels between neighbours, and float32's rounding of a weighted sum near 1
LEVEL = 0.5 / 255 + 1e-6


@pytest.fixture
def frame(tiny_dataset):
    return open_listing(tiny_dataset).frames[0]


def ramp():
    """Coverage from 0 (the eight left columns) to 1."""
    return np.broadcast_to(np.clip((np.arange(32) - 7) / 16, 0, 1), (32, 32)).astype(np.float32)


def blend(colour, background, mask):
    return mask[..., None] * colour + (1 - mask[..., None]) * background


def test_pixels_are_those_of_the_files(frame):
    pixels = load_pixels(frame, **SIZE)
    files = (
        (pixels.image, frame.image_path, 3),
        (pixels.albedo, frame.albedo_path, 3),
        (pixels.mask[..., None], frame.mask_path, 1),
    )
    for ours, path, channels in files:
        assert ours.dtype == torch.float32
        np.testing.assert_array_equal(ours.numpy(), read_image(path, channels=channels))


def test_an_absent_albedo_is_none(tiny_dataset):
    assert load_pixels(open_listing(tiny_dataset).frames[-1], **SIZE).albedo is None


@pytest.mark.parametrize(("width", "height"), [(16, 16), (12, 20)])
def test_all_are_box_resized(frame, width, height):
    pixels, whole = load_pixels(frame, width=width, height=height), load_pixels(frame, **SIZE)
    assert (pixels.image.shape, pixels.mask.shape, pixels.albedo.shape) == (
        (height, width, 3),
        (height, width),
        (height, width, 3),
    )
    for ours, full in ((pixels.image, whole.image), (pixels.mask, whole.mask), (pixels.albedo, whole.albedo)):
        np.testing.assert_array_equal(ours.numpy(), resize_box(full.numpy(), width=width, height=height))
        assert ours.mean().item() == pytest.approx(full.mean().item(), abs=1e-6)


def test_an_alpha_channel_is_laid_on_white_and_is_the_mask(frame, tmp_path):
    mask = ramp()
    write_png(tmp_path / "rgba.png", np.dstack([np.broadcast_to(COLOUR, (32, 32, 3)), mask]))
    frame = replace(frame, image_path=tmp_path / "rgba.png", mask_path=None, albedo_path=None)
    pixels = load_pixels(frame, **SIZE)
    np.testing.assert_allclose(pixels.mask.numpy(), mask, atol=LEVEL)
    # colour and coverage are each rounded to a level
    np.testing.assert_allclose(pixels.image.numpy(), blend(COLOUR, 1.0, mask), atol=2 * LEVEL)
    torch.testing.assert_close(load_mask(frame, **SIZE), pixels.mask)


def test_a_mask_file_outweighs_the_alpha_channel_as_coverage(frame, tmp_path):
    narrower = np.minimum(ramp(), ramp()[::-1].T)
    write_png(tmp_path / "rgba.png", np.dstack([np.broadcast_to(COLOUR, (32, 32, 3)), ramp()]))
    write_png(tmp_path / "mask.png", narrower)
    frame = replace(
        frame, image_path=tmp_path / "rgba.png", mask_path=tmp_path / "mask.png", albedo_path=None
    )
    pixels = load_pixels(frame, **SIZE)
    np.testing.assert_allclose(pixels.mask.numpy(), narrower, atol=LEVEL)
    # what the alpha leaves of the picture and the mask does not take for the head is the scene
    cut_out = blend(blend(COLOUR, 1.0, ramp()), 1.0, narrower)
    np.testing.assert_allclose(pixels.image.numpy(), cut_out, atol=3 * LEVEL)


def test_without_mask_and_alpha_all_is_covered(frame):
    frame = replace(frame, mask_path=None)
    assert (load_pixels(frame, **SIZE).mask == 1).all()
    assert load_mask(frame, **SIZE) is None


@pytest.mark.parametrize("background", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_background_of_one_colour_becomes_white(frame, tmp_path, background):
    """What the export blended with its background is what it would have blended with white, whatever the
    coverage."""
    mask = ramp()
    write_png(tmp_path / "image.png", blend(COLOUR, background, mask))
    write_png(tmp_path / "mask.png", mask)
    pixels = load_pixels(
        replace(frame, image_path=tmp_path / "image.png", mask_path=tmp_path / "mask.png", albedo_path=None),
        **SIZE,
    )
    np.testing.assert_allclose(pixels.image.numpy(), blend(COLOUR, 1.0, mask), atol=2 * LEVEL)


def test_a_scene_behind_the_head_is_cut_away_by_the_mask():
    scene = np.random.default_rng(0).random((32, 32, 3)).astype(np.float32)
    mask = ramp()
    np.testing.assert_allclose(on_white(scene, mask), blend(scene, 1.0, mask), atol=1e-6)


def test_an_image_without_background_is_cut_by_its_mask():
    scene = np.random.default_rng(0).random((4, 4, 3)).astype(np.float32)
    assert np.array_equal(on_white(scene, np.ones((4, 4), np.float32)), scene)
    half = np.full((4, 4), 0.5, np.float32)
    np.testing.assert_allclose(on_white(scene, half), 0.5 * scene + 0.5, atol=1e-6)


def test_an_albedo_with_alpha_is_laid_on_white(frame, tmp_path):
    write_png(tmp_path / "albedo.png", np.dstack([np.broadcast_to(COLOUR, (32, 32, 3)), ramp()]))
    pixels = load_pixels(replace(frame, albedo_path=tmp_path / "albedo.png"), **SIZE)
    np.testing.assert_allclose(pixels.albedo.numpy(), blend(COLOUR, 1.0, ramp()), atol=2 * LEVEL)


@pytest.mark.parametrize("kind", ["image_path", "mask_path", "albedo_path"])
def test_a_file_that_vanished_is_named(frame, tmp_path, kind):
    with pytest.raises(UserError, match="no such file") as caught:
        load_pixels(replace(frame, **{kind: tmp_path / "gone.png"}), **SIZE)
    assert str(tmp_path / "gone.png") in str(caught.value)
