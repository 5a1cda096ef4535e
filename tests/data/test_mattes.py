"""Masks of every kind that programs write, and pictures that say more than their colours."""

from dataclasses import replace

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import pytest
from PIL import Image, ImageOps

from samira_warp.data import load_pixels, open_listing
from samira_warp.data.mattes import read_matte
from samira_warp.data.pixels import load_mask
from samira_warp.io.images import image_size, read_image, read_on_white, read_rgba
from samira_warp.support.errors import UserError

SIZE = 32


@pytest.fixture
def frame(tiny_dataset):
    return open_listing(tiny_dataset).frames[0]


@pytest.fixture
def scene():
    return np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), np.uint8)


def disc(soft=True):
    """Coverage (H, W) of a disc, its edge two pixels wide or none."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5 - SIZE / 2
    distance = 10.0 - np.hypot(x, y)
    return np.clip(0.5 + 0.5 * distance, 0.0, 1.0) if soft else (distance > 0.0).astype(float)


def write(path, pixels, kind, names=None, **attributes):
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    if names is not None:
        spec.channelnames = names
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    output.close()


def codes(coverage, largest, dtype):
    return np.rint(coverage * largest).astype(dtype)


def coloured(coverage):
    return codes(coverage, 255, np.uint8)[..., None].repeat(3, axis=2)


def cut_out(coverage, mode):
    colour = np.random.default_rng(1).integers(0, 256, (SIZE, SIZE, 3 if mode == "RGBA" else 1), np.uint8)
    return Image.fromarray(np.dstack([colour, codes(coverage, 255, np.uint8)]), mode)


def palette(colours):
    picture = Image.fromarray(codes(disc(soft=False), 1, np.uint8), "P")
    picture.putpalette(colours)
    return picture


KINDS = {
    "grey of 8 bits": lambda path: Image.fromarray(codes(disc(), 255, np.uint8)).save(path),
    "grey as colours": lambda path: Image.fromarray(coloured(disc())).save(path),
    "grey of 16 bits": lambda path: Image.fromarray(codes(disc(), 65535, np.uint16)).save(path),
    "8 bits in 16": lambda path: Image.fromarray(codes(disc(), 255, np.uint16)).save(path),
    "a cut-out": lambda path: cut_out(disc(), "RGBA").save(path),
    "a grey cut-out": lambda path: cut_out(disc(), "LA").save(path),
    "grey beside an opaque alpha": lambda path: Image.fromarray(
        np.dstack([coloured(disc()), np.full((SIZE, SIZE), 255, np.uint8)])
    ).save(path),
}  # fmt: skip
HARD_KINDS = {
    "0 and 1": lambda path: Image.fromarray(codes(disc(soft=False), 1, np.uint8)).save(path),
    "0 and 1 in 16 bits": lambda path: Image.fromarray(codes(disc(soft=False), 1, np.uint16)).save(path),
    "one bit": lambda path: Image.fromarray(disc(soft=False) > 0.5).save(path),
    "a palette of black and white": lambda path: palette([0, 0, 0, 255, 255, 255]).save(path),
    "a palette of black and red": lambda path: palette([0, 0, 0, 128, 0, 0]).save(path),
}


@pytest.mark.parametrize("kind", [*KINDS, *HARD_KINDS])
def test_masks_are_read_as_what_they_are(tmp_path, kind, frame):
    path, soft = tmp_path / "mask.png", kind in KINDS
    (KINDS if soft else HARD_KINDS)[kind](path)
    # half a step of 8 bits
    assert np.abs(read_matte(path) - disc(soft)).max() <= 0.5 / 255 + 1e-6
    seen = load_mask(replace(frame, mask_path=path), width=SIZE, height=SIZE)
    np.testing.assert_array_equal(seen.numpy(), read_matte(path))


@pytest.mark.parametrize(("suffix", "kind"), [("tif", oiio.UINT8), ("exr", oiio.FLOAT), ("tif", oiio.FLOAT)])
def test_masks_of_alpha_alone_and_of_floats(tmp_path, suffix, kind):
    path = tmp_path / f"mask.{suffix}"
    write(path, disc()[..., None].astype(np.float32), kind, ("A",))
    assert np.abs(read_matte(path) - disc()).max() <= 0.5 / 255 + 1e-6


def test_an_empty_mask_and_a_full_one_stay_so(tmp_path):
    for value in (0, 255):
        Image.fromarray(np.full((SIZE, SIZE), value, np.uint8)).save(tmp_path / "mask.png")
        np.testing.assert_array_equal(read_matte(tmp_path / "mask.png"), np.full((SIZE, SIZE), value / 255.0))


REFUSED = {
    "labels of regions": (
        lambda scene: scene[..., 0] // 14, "whole numbers from 0 to 18, which may be labels of regions",
    ),
    "a photograph": (lambda scene: scene, "a picture in colours"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_mask_is_refused_in_words_of_its_own(tmp_path, scene, name):
    make, found = REFUSED[name]
    Image.fromarray(make(scene)).save(tmp_path / "mask.png")
    with pytest.raises(UserError, match=f"mask.png: expected the head's coverage .*{found}"):
        read_matte(tmp_path / "mask.png")


@pytest.mark.parametrize("worst", [2.0, -0.5, np.nan])
def test_floats_that_are_no_coverage_are_refused(tmp_path, worst):
    values = disc()[..., None].astype(np.float32)
    values[3, 4] = worst
    write(tmp_path / "mask.exr", values, oiio.FLOAT, ("Y",))
    with pytest.raises(UserError, match="from 0 to 1"):
        read_matte(tmp_path / "mask.exr")


# --- what is the head and what is the scene


def head_before(scene, coverage):
    """8-bit picture of a plain head before a scene."""
    return codes(
        coverage[..., None] * [0.8, 0.6, 0.5] + (1 - coverage[..., None]) * (scene / 255.0), 255, np.uint8
    )


@pytest.mark.parametrize("least", [0.0, 0.0006, 0.01, 0.05])
@pytest.mark.parametrize("opaque_alpha", [False, True])
def test_the_scene_is_not_the_head_s(tmp_path, frame, scene, least, opaque_alpha):
    """Mattes of a network never quite reach 0, and some programs write an alpha that says nothing."""
    picture = head_before(scene, disc())
    if opaque_alpha:
        picture = np.dstack([picture, np.full((SIZE, SIZE), 255, np.uint8)])
    Image.fromarray(picture).save(tmp_path / "picture.png")
    Image.fromarray(codes(least + (1 - least) * disc(), 65535, np.uint16)).save(tmp_path / "mask.png")
    paths = {"image_path": tmp_path / "picture.png", "mask_path": tmp_path / "mask.png"}
    pixels = load_pixels(replace(frame, **paths), width=SIZE, height=SIZE)
    outside, inside = disc() == 0.0, disc() == 1.0
    assert np.abs(1.0 - pixels.image.numpy()[outside]).max() <= 1e-4  # 16-bit coverage of a bright scene
    assert np.abs(pixels.image.numpy()[inside] - [0.8, 0.6, 0.5]).max() <= 0.5 / 255 + 1e-6


@pytest.mark.parametrize("least", [0.0, 0.01])
def test_an_export_s_background_is_taken_off_whatever_the_matte_s_least(tmp_path, frame, least):
    black = np.zeros((SIZE, SIZE, 3))
    Image.fromarray(head_before(black, disc())).save(tmp_path / "picture.png")
    Image.fromarray(codes(least + (1 - least) * disc(), 65535, np.uint16)).save(tmp_path / "mask.png")
    paths = {"image_path": tmp_path / "picture.png", "mask_path": tmp_path / "mask.png"}
    pixels = load_pixels(replace(frame, **paths), width=SIZE, height=SIZE)
    expected = disc()[..., None] * [0.8, 0.6, 0.5] + 1 - disc()[..., None]
    assert np.abs(pixels.image.numpy() - expected).max() <= least + 0.5 / 255 + 1e-6


def test_a_cut_out_with_some_scene_left_is_cut_by_its_mask_too(tmp_path, frame, scene):
    larger = np.clip(disc() + np.roll(disc(), 8, axis=1), 0.0, 1.0)
    picture = np.dstack([head_before(scene, disc()), codes(larger, 255, np.uint8)])
    Image.fromarray(picture).save(tmp_path / "picture.png")
    Image.fromarray(codes(disc(), 255, np.uint8)).save(tmp_path / "mask.png")
    paths = {"image_path": tmp_path / "picture.png", "mask_path": tmp_path / "mask.png"}
    pixels = load_pixels(replace(frame, **paths), width=SIZE, height=SIZE)
    assert np.abs(1.0 - pixels.image.numpy()[disc() == 0.0]).max() <= 1e-6


def test_a_head_that_fills_the_frame_keeps_it(tmp_path, frame):
    Image.fromarray(np.full((SIZE, SIZE, 3), 120, np.uint8)).save(tmp_path / "picture.png")
    Image.fromarray(np.full((SIZE, SIZE), 255, np.uint8)).save(tmp_path / "mask.png")
    paths = {"image_path": tmp_path / "picture.png", "mask_path": tmp_path / "mask.png"}
    pixels = load_pixels(replace(frame, **paths), width=SIZE, height=SIZE)
    assert np.abs(pixels.image.numpy() - 120 / 255).max() <= 1e-6


# --- pictures whose alpha is multiplied in, and pictures that lie


@pytest.mark.parametrize(("suffix", "kind"), [("tif", oiio.UINT8), ("tif", oiio.UINT16), ("exr", oiio.FLOAT)])
def test_premultiplied_colours_are_made_straight(tmp_path, suffix, kind):
    straight = np.ones((SIZE, SIZE, 3)) * [0.9, 0.6, 0.3]
    alpha = np.clip(disc(), 0.25, 1.0)[..., None]
    path = tmp_path / f"picture.{suffix}"
    write(path, np.concatenate([straight * alpha, alpha], axis=2).astype(np.float32), kind)
    colour, found = read_rgba(path)
    step = 1.0 / 255 if kind == oiio.UINT8 else 1e-4
    assert np.abs(found - alpha[..., 0]).max() <= step
    # a step of colour and one of alpha, divided by the least alpha
    assert np.abs(colour - straight).max() <= 2 * step / 0.25
    assert np.abs(read_on_white(path) - (straight * alpha + 1 - alpha)).max() <= 3 * step


def test_straight_alpha_stays_straight(tmp_path, scene):
    Image.fromarray(np.dstack([scene, np.full((SIZE, SIZE), 128, np.uint8)])).save(tmp_path / "picture.png")
    np.testing.assert_allclose(read_rgba(tmp_path / "picture.png")[0], scene / 255.0, atol=1e-6)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_put_upright_as_their_camera_was_held(tmp_path, suffix, orientation):
    gradient = np.linspace(0, 255, 24 * 40).reshape(24, 40)
    picture = Image.fromarray(np.dstack([gradient, gradient[::-1], gradient[:, ::-1]]).astype(np.uint8))
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"picture.{suffix}"
    picture.save(path, exif=exif, **({} if suffix in ("tif", "png") else {"quality": 100}))
    with Image.open(path) as stored:
        upright = np.asarray(ImageOps.exif_transpose(stored).convert("RGB"))  # Pillow's own reading
    found = read_image(path, channels=3) * 255.0
    assert found.shape == upright.shape
    assert np.abs(found - upright).max() <= 3.0  # two decoders of lossy files
    assert image_size(path) == upright.shape[1::-1]
