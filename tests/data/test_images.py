"""Image files in and out, and the two ways of changing an image's size."""

import struct
import zlib

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import pytest
from data.damage import file_size_limit
from PIL import Image
from skimage.transform import downscale_local_mean

from samira_warp.io.images import (
    image_size,
    read_channels,
    read_image,
    read_labels,
    read_on_white,
    read_rgba,
    resize_box,
    resize_nearest,
    to_uint8,
    write_exr,
    write_png,
)
from samira_warp.support.errors import UserError


@pytest.fixture
def noise():
    return np.random.default_rng(0).integers(0, 256, (6, 9, 4), dtype=np.uint8)


def test_whole_numbers_of_16_bits_come_back_exactly(tmp_path):
    numbers = np.arange(0, 65536, 257, dtype=np.uint16).reshape(16, 16)
    write_png(tmp_path / "grey.png", numbers)
    assert read_channels(tmp_path / "grey.png").full_scale == 65535
    found = read_image(tmp_path / "grey.png", channels=1)[..., 0]
    np.testing.assert_allclose(found, numbers / 65535.0, rtol=1e-6)


def test_an_8_bit_png_comes_back_exactly(tmp_path, noise):
    path = tmp_path / "a.png"
    write_png(path, noise[..., :3])
    assert image_size(path) == (9, 6)
    ours = read_image(path, channels=3)
    assert ours.dtype == np.float32
    np.testing.assert_array_equal(to_uint8(ours), noise[..., :3])
    np.testing.assert_array_equal(np.asarray(Image.open(path)), noise[..., :3])


def test_floats_are_rounded_and_clipped(tmp_path):
    write_png(tmp_path / "a.png", np.array([[-1.0, 0.0, 0.4 / 255, 0.6 / 255, 1.0, 7.0]]))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), [[0, 0, 0, 1, 255, 255]])


def test_grey_and_colour_are_exchanged(tmp_path, noise):
    write_png(tmp_path / "grey.png", noise[..., 0])
    write_png(tmp_path / "colour.png", noise[..., :3])
    grey = noise[..., :1].astype(np.float32) / 255
    np.testing.assert_allclose(
        read_image(tmp_path / "grey.png", channels=3), np.repeat(grey, 3, axis=2), atol=1e-7
    )
    np.testing.assert_allclose(
        read_image(tmp_path / "colour.png", channels=1)[..., 0], noise[..., :3].mean(axis=2) / 255, atol=1e-6
    )


def test_alpha_is_straight(tmp_path, noise):
    """Neither writing nor reading multiplies the colour by alpha, even where that is 0."""
    noise[0, :, 3] = 0
    write_png(tmp_path / "a.png", noise)
    colour, alpha = read_rgba(tmp_path / "a.png")
    np.testing.assert_array_equal(to_uint8(colour), noise[..., :3])
    np.testing.assert_array_equal(to_uint8(alpha), noise[..., 3])
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), noise)
    coverage = noise[..., 3:] / 255
    np.testing.assert_allclose(
        read_on_white(tmp_path / "a.png"), coverage * noise[..., :3] / 255 + 1 - coverage, atol=1e-6
    )
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", channels=3), colour)


def test_grey_with_alpha(tmp_path):
    Image.fromarray(np.array([[[100, 51], [200, 255]]], np.uint8), mode="LA").save(tmp_path / "a.png")
    colour, alpha = read_rgba(tmp_path / "a.png")
    np.testing.assert_allclose(colour, np.repeat([[[100 / 255], [200 / 255]]], 3, axis=2), atol=1e-6)
    np.testing.assert_allclose(alpha, [[0.2, 1.0]], atol=1e-6)


def test_no_alpha_is_none(tmp_path, noise):
    write_png(tmp_path / "a.png", noise[..., :3])
    assert read_rgba(tmp_path / "a.png")[1] is None


def test_16_bits(tmp_path):
    values = np.array([[0, 1, 257, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_image(tmp_path / "a.png", channels=1)[..., 0], values / 65535, atol=1e-7)


def test_a_jpeg_is_read(tmp_path):
    Image.new("RGB", (16, 8), (200, 100, 50)).save(tmp_path / "a.jpg", quality=95)
    assert image_size(tmp_path / "a.jpg") == (16, 8)
    np.testing.assert_allclose(
        read_image(tmp_path / "a.jpg", channels=3)[4, 8], np.array([200, 100, 50]) / 255, atol=2 / 255
    )


def test_an_exr_keeps_floats_whatever_their_range(tmp_path):
    values = np.array([[[-1.5, 0.0, 1e-6], [3.25, 1e4, 0.1]]], np.float32)
    write_exr(tmp_path / "a.exr", values)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr", channels=3), values)
    write_exr(tmp_path / "grey.exr", values[..., 0])
    np.testing.assert_array_equal(read_image(tmp_path / "grey.exr", channels=1), values[..., :1])


def test_an_hdr_is_linear_radiance(tmp_path):
    values = np.array([[[4.0, 2.0, 1.0], [0.5, 0.25, 0.125]]], np.float32)
    output = oiio.ImageOutput.create(str(tmp_path / "a.hdr"))
    assert output.open(str(tmp_path / "a.hdr"), oiio.ImageSpec(2, 1, 3, oiio.FLOAT))
    assert output.write_image(values)
    assert output.close()
    # RGBE has 8 bits beside an exponent shared by the pixel
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr", channels=3), values, rtol=1 / 64)


def test_labels_are_not_scaled(tmp_path):
    write_png(tmp_path / "a.png", np.array([[0, 1, 7, 255]], np.uint8))
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png"), [[0, 1, 7, 255]])


@pytest.mark.parametrize("kind", ["colour", "16 bits", "alpha"])
def test_labels_of_another_kind_are_refused(tmp_path, noise, kind):
    path = tmp_path / "labels.png"
    picture = {"colour": noise[..., :3], "16 bits": noise[..., 0].astype(np.uint16), "alpha": noise}[kind]
    Image.fromarray(picture).save(path)
    with pytest.raises(UserError, match="8-bit grey labels") as caught:
        read_labels(path)
    assert str(path) in str(caught.value)


def chunk(name, body):
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


HEADER = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0))
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def broken(kind, whole):
    return {
        "empty": b"",
        "text": b"hello",
        "signature alone": SIGNATURE,
        "half": whole[: len(whole) // 2],
        "no end": whole[:-12],
        "a cut end": whole[:-5],
        "a flipped bit": whole[:60] + bytes([whole[60] ^ 1]) + whole[61:],
        "pixels that do not inflate": SIGNATURE
        + HEADER
        + chunk(b"IDAT", b"not deflated")
        + chunk(b"IEND", b""),
        "too few pixels": SIGNATURE
        + HEADER
        + chunk(b"IDAT", zlib.compress(b"\x00" * 13))
        + chunk(b"IEND", b""),
        "no pixels": SIGNATURE + HEADER + chunk(b"IEND", b""),
    }[kind]


BROKEN = ["empty", "text", "signature alone", "half", "no end", "a cut end", "a flipped bit"]
# libpng prints a line of its own about these: to find them first would mean inflating each picture twice
INSIDE = ["pixels that do not inflate", "too few pixels"]
BROKEN += [*INSIDE, "no pixels"]


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_png_is_named_and_nothing_else_is_said(tmp_path, noise, capfd, kind):
    path = tmp_path / "a.png"
    write_png(path, noise[..., :3])
    path.write_bytes(broken(kind, path.read_bytes()))
    with pytest.raises(UserError) as caught:
        read_image(path, channels=3)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    if kind not in INSIDE:
        assert capfd.readouterr() == ("", "")
    write_png(path, noise[..., :3])
    read_image(path, channels=3)  # nothing of the fault lingers


@pytest.mark.parametrize("suffix", [".jpg", ".exr", ".hdr", ".xyz"])
def test_a_file_of_another_kind_is_named(tmp_path, capfd, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text("hello")
    for read in (image_size, lambda path: read_image(path, channels=3)):
        with pytest.raises(UserError, match="readable image") as caught:
            read(path)
        assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "read", [image_size, read_rgba, read_labels, read_on_white, lambda path: read_image(path, channels=1)]
)
def test_missing_files_and_folders(tmp_path, read):
    with pytest.raises(UserError, match=r"gone\.png.*no such file"):
        read(tmp_path / "gone.png")
    with pytest.raises(UserError, match="a folder"):
        read(tmp_path)


def test_the_size_is_read_of_a_file_whose_pixels_are_broken(tmp_path, noise):
    write_png(tmp_path / "a.png", noise[..., :3])
    (tmp_path / "a.png").write_bytes((tmp_path / "a.png").read_bytes()[:-12])
    assert image_size(tmp_path / "a.png") == (9, 6)


def test_colour_of_two_channels_is_refused(tmp_path):
    output = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert output.open(str(tmp_path / "a.tif"), oiio.ImageSpec(2, 2, 2, oiio.UINT8))
    output.write_image(np.zeros((2, 2, 2), np.uint8))
    output.close()
    with pytest.raises(UserError, match="2 colour channels"):
        read_image(tmp_path / "a.tif", channels=3)


@pytest.mark.parametrize(("write", "suffix"), [(write_png, ".png"), (write_exr, ".exr")])
def test_what_cannot_be_written_is_an_os_error(tmp_path, write, suffix):
    path = tmp_path / "no folder" / f"a{suffix}"
    with pytest.raises(OSError, match="cannot be written") as caught:
        write(path, np.zeros((2, 2, 3)))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("write", "suffix"), [(write_png, ".png"), (write_exr, ".exr")])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_disk_that_takes_a_part_is_an_os_error(tmp_path, write, suffix, share):
    path, values = tmp_path / f"a{suffix}", np.random.default_rng(0).random((96, 96, 3))
    write(path, values)
    with (
        file_size_limit(int(share * path.stat().st_size)),
        pytest.raises(OSError, match="cannot be written") as caught,
    ):
        write(path, values)
    assert str(path) in str(caught.value)
    write(path, values)
    assert read_image(path, channels=3).shape == (96, 96, 3)  # nothing of the fault lingers


def test_boxes_of_a_whole_factor_are_block_means():
    image = np.random.default_rng(0).random((12, 20, 3))
    np.testing.assert_allclose(
        resize_box(image, width=5, height=4), downscale_local_mean(image, (3, 4, 1)), atol=1e-15
    )
    np.testing.assert_allclose(
        resize_box(image[..., 0], width=5, height=4), downscale_local_mean(image[..., 0], (3, 4)), atol=1e-15
    )


@pytest.mark.parametrize(("width", "height"), [(7, 5), (9, 12), (20, 5), (13, 11), (1, 1)])
def test_boxes_of_any_factor_are_exact_area_means(width, height):
    """Blown up by whole factors to a common multiple, any factor becomes a whole one."""
    image = np.random.default_rng(0).random((12, 20, 2))
    ours = resize_box(image, width=width, height=height)
    fine = image.repeat(height, axis=0).repeat(width, axis=1)
    np.testing.assert_allclose(ours, downscale_local_mean(fine, (12, 20, 1)), atol=1e-14)
    np.testing.assert_allclose(ours.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=1e-14)


def test_enlarging_splits_pixels():
    np.testing.assert_allclose(resize_box(np.array([[0.0, 1.0]]), width=4, height=2), [[0, 0, 1, 1]] * 2)
    np.testing.assert_allclose(resize_box(np.array([[0.0, 1.0]]), width=3, height=1), [[0, 0.5, 1]])


def test_the_right_size_is_left_as_it_is():
    image = np.zeros((4, 5, 3), np.float32)
    assert resize_box(image, width=5, height=4) is image
    assert resize_box(image, width=3, height=3).dtype == np.float32


def test_labels_take_the_value_at_the_centre():
    labels = np.arange(16, dtype=np.uint8).reshape(4, 4)
    np.testing.assert_array_equal(resize_nearest(labels, width=4, height=4), labels)
    np.testing.assert_array_equal(resize_nearest(labels, width=8, height=8), labels.repeat(2, 0).repeat(2, 1))
    # centres of a third of 4 pixels lie at 2/3, 2 and 10/3: pixels 0, 2 and 3
    np.testing.assert_array_equal(resize_nearest(labels, width=3, height=1), [[8, 10, 11]])
    assert resize_nearest(labels, width=3, height=1).dtype == np.uint8
