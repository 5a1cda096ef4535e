"""Light files mean what their headers say."""

import logging
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import pytest
import torch

from samira_warp.light import Environment, encode_srgb
from samira_warp.light.radiance_file import HALF_MAX, MOST_INFINITE, read_radiance
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.support.errors import UserError

HEIGHT, WIDTH = 16, 32


def sky():
    """A panorama that differs in every direction and channel."""
    return np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32) + np.float32([0.1, 0.2, 0.3])


def header(pixels, names=("R", "G", "B"), *, kind=oiio.FLOAT, tile=0, window=None, **attributes):
    """A part's header: ``window`` is (x, y) of the first stored pixel in a picture of HEIGHT x WIDTH."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.channelnames = names
    spec.tile_width = spec.tile_height = tile
    if window is not None:
        spec.x, spec.y = window
        spec.full_x, spec.full_y, spec.full_width, spec.full_height = 0, 0, WIDTH, HEIGHT
    for name, value in attributes.items():
        if isinstance(value, tuple):
            spec.attribute(name, oiio.TypeDesc(f"float[{len(value)}]"), value)
        else:
            spec.attribute(name, value)
    return spec


def write(path, *parts):
    """Write (pixels, header) as the parts of a file."""
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), tuple(spec for _, spec in parts)), output.geterror()
    for number, (pixels, spec) in enumerate(parts):
        assert number == 0 or output.open(str(path), spec, "AppendSubimage"), output.geterror()
        assert output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    assert output.close()
    return path


def one(path, pixels, **options):
    return write(path, (pixels, header(pixels, **options)))


def radiance(path, **options):
    return read_radiance(path, **{"ldr": False, **options}).numpy()


# windows


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
@pytest.mark.parametrize("tile", [0, 16])
@pytest.mark.parametrize(
    ("left", "top", "right", "bottom"),
    [(4, 2, 20, 9), (0, 0, WIDTH, 5), (-3, -2, 35, 18), (-3, 4, 7, 18), (20, -2, 40, 3)],
)
def test_what_is_stored_lies_where_its_window_says(tmp_path, suffix, tile, left, top, right, bottom):
    if suffix == ".tif" and min(left, top) < 0:
        left, top = max(left, 0), max(top, 0)  # TIFF's positions are not negative
    wide = np.random.default_rng(1).random((HEIGHT + 20, WIDTH + 20, 3)).astype(np.float32)
    stored = wide[10 + top : 10 + bottom, 10 + left : 10 + right]
    expected = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    rows = slice(max(top, 0), min(bottom, HEIGHT))
    columns = slice(max(left, 0), min(right, WIDTH))
    expected[rows, columns] = wide[10:-10, 10:-10][rows, columns]
    path = one(tmp_path / f"a{suffix}", stored, tile=tile, window=(left, top))
    np.testing.assert_array_equal(radiance(path), expected)


def test_a_lamp_stored_by_itself_lights_as_much_as_in_its_picture(tmp_path):
    whole = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    whole[2:6, 16:24] = [30, 20, 10]
    lights = [
        Environment.load(path, size=16)
        for path in (
            one(tmp_path / "whole.exr", whole),
            one(tmp_path / "lamp.exr", whole[2:6, 16:24], window=(16, 2)),
        )
    ]
    assert torch.equal(lights[0].specular, lights[1].specular)


def test_pixels_beside_the_picture_are_refused(tmp_path):
    path = one(tmp_path / "a.exr", sky()[:4, :4], window=(WIDTH, 0))
    with pytest.raises(UserError, match=r"a\.exr: expected pixels within the picture \(display window\)"):
        radiance(path)


# parts and layers


@pytest.mark.parametrize(
    ("names", "chosen", "others"),
    [
        (["normals", "beauty"], "beauty", ""),
        (["depth", "N", "rgba"], "rgba", ""),
        (["diffuse", "specular", "ViewLayer.Combined"], "ViewLayer.Combined", "diffuse, specular"),
        (["albedo", "lights"], "lights", ""),
        (["worldNormal", "shading_normals", "motionvector", "P", "crypto_object", "C"], "C", ""),
        (["rgba_sun", "rgba"], "rgba", "rgba_sun"),
        (["beauty.right", "beauty.left"], "beauty.left", "beauty.right"),
        (["indirect_diffuse", "environment"], "environment", "indirect_diffuse"),
    ],
)
def test_of_parts_the_picture_is_chosen_by_name_and_said(tmp_path, caplog, names, chosen, others):
    generator = np.random.default_rng(0)
    parts = [generator.random((HEIGHT, WIDTH, 3)).astype(np.float32) for _ in names]
    path = write(
        tmp_path / "a.exr",
        *(
            (part, header(part, **{"oiio:subimagename": name}))
            for part, name in zip(parts, names, strict=True)
        ),
    )
    with caplog.at_level(logging.WARNING):
        found = radiance(path)
    np.testing.assert_array_equal(found, parts[names.index(chosen)])
    said = [record.getMessage() for record in caplog.records]
    assert said == ([f"{path}: the light is {chosen}, not {others}"] if others else [])


def test_of_views_the_first_eye_is_chosen(tmp_path):
    left, right = sky(), 2 * sky()
    path = write(
        tmp_path / "a.exr",
        (right, header(right, **{"oiio:subimagename": "r", "view": "right"})),
        (left, header(left, **{"oiio:subimagename": "l", "view": "left"})),
    )
    np.testing.assert_array_equal(radiance(path), left)


def test_a_part_that_says_it_is_no_picture_is_not_taken(tmp_path):
    picture, data = sky(), 2 * sky()
    path = write(
        tmp_path / "a.exr",
        (data, header(data, **{"oiio:subimagename": "a", "colorInteropID": "data"})),
        (picture, header(picture, **{"oiio:subimagename": "b"})),
    )
    np.testing.assert_array_equal(radiance(path), picture)


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("A", "B", "G", "R", "Z", "N.X", "N.Y", "N.Z"), ("R", "G", "B")),
        (("diffuse.R", "diffuse.G", "diffuse.B", "R", "G", "B"), ("R", "G", "B")),
        (("Scene.Combined.B", "Scene.Combined.G", "Scene.Combined.R", "Scene.Depth.Z"), "RGB"),
        (("red", "green", "blue"), ("red", "green", "blue")),
        (("normal.R", "normal.G", "normal.B", "beauty.R", "beauty.G", "beauty.B"), "beauty"),
        (("Y",), ("Y",) * 3),
        (("A", "Y"), ("Y",) * 3),
        (("Y", "Z"), ("Y",) * 3),
        (("Y", "N.X", "N.Y", "N.Z"), ("Y",) * 3),
    ],
)
def test_channels_are_read_by_name(tmp_path, names, chosen):
    if chosen == "RGB":
        chosen = tuple(f"Scene.Combined.{name}" for name in "RGB")
    elif chosen == "beauty":
        chosen = tuple(f"beauty.{name}" for name in "RGB")
    pixels = np.random.default_rng(0).random((HEIGHT, WIDTH, len(names))).astype(np.float32)
    found = radiance(one(tmp_path / "a.exr", pixels, names=names))
    np.testing.assert_array_equal(found, pixels[..., [names.index(name) for name in chosen]])


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("Z",), "found Z"),
        (("normals.R", "normals.G", "normals.B"), "found normals.R"),
        (("N.X", "N.Y", "N.Z"), "found N.X, N.Y, N.Z"),
        (("Y", "RY", "BY"), "found Y, BY, RY"),
        (("R", "G"), "found R, G"),
        (("A",), "found A"),
        (("one.R", "one.G", "one.B", "two.R", "two.G", "two.B"), "found one, two"),
        (
            ("diffuse.R", "diffuse.G", "diffuse.B", "specular.R", "specular.G", "specular.B"),
            "diffuse, specular",
        ),
    ],
)
def test_what_has_no_light_that_can_be_told_is_refused(tmp_path, names, found):
    pixels = np.ones((HEIGHT, WIDTH, len(names)), np.float32)
    path = one(tmp_path / "a.exr", pixels, names=names)
    with pytest.raises(UserError, match=found) as caught:
        radiance(path)
    assert str(path) in str(caught.value)


# primaries

ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)


@pytest.mark.parametrize("stated", [{"chromaticities": ACESCG}, {"colorInteropID": "lin_ap1_scene"}])
def test_acescg_is_converted(tmp_path, stated):
    """The matrix as OpenColorIO's ACES configuration has it, to the five digits that are published."""
    matrix = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    pixels = sky()
    expected = np.maximum(pixels @ np.float32(matrix).T, 0.0)
    found = radiance(one(tmp_path / "a.exr", pixels, **stated))
    # five digits of three products of values below 1.3
    np.testing.assert_allclose(found, expected, atol=3 * 1.3 * 5e-6 + 1e-6)
    grey = one(tmp_path / "grey.exr", np.full((HEIGHT, WIDTH, 3), 0.5, np.float32), **stated)
    np.testing.assert_allclose(radiance(grey), 0.5, atol=1e-6)  # white stays white


def test_rec_709_stated_in_any_digits_keeps_its_bits(tmp_path):
    pixels = sky()
    for primaries in (
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.313, 0.329),
    ):
        found = radiance(one(tmp_path / "a.exr", pixels, chromaticities=primaries))
        np.testing.assert_array_equal(found, pixels)


@pytest.mark.parametrize(
    ("stated", "found"),
    [
        ({"chromaticities": (0.3, 0.3) * 4}, "span no triangle"),
        ({"chromaticities": (0.0,) * 8}, "span no triangle"),
        ({"colorInteropID": "srgb_rec709_scene"}, "the colour space srgb_rec709_scene"),
    ],
)
def test_colours_that_are_not_known_are_refused(tmp_path, stated, found):
    with pytest.raises(UserError, match=found):
        radiance(one(tmp_path / "a.exr", sky(), **stated))


# Radiance files


def rgbe(pixels):
    """RGBE of values that it holds exactly."""
    largest = pixels.max(axis=-1)
    exponents = np.ceil(np.log2(np.maximum(largest, 1e-30))).astype(int)
    mantissas = pixels * (256.0 / 2.0**exponents)[..., None]
    return np.concatenate([mantissas, (exponents + 128)[..., None]], axis=-1).astype(np.uint8).tobytes()


def exact():
    """Values of the form n / 64 with n from 128 to 255, which RGBE holds."""
    return (np.random.default_rng(0).integers(129, 256, (HEIGHT, WIDTH, 3)) / 64).astype(np.float32)


def hdr(path, pixels, *lines, resolution=None, ending="\n"):
    height, width = pixels.shape[:2]
    head = ["#?RADIANCE", *lines, "FORMAT=32-bit_rle_rgbe", "", resolution or f"-Y {height} +X {width}", ""]
    path.write_bytes(ending.join(head).encode() + rgbe(pixels))
    return path


ORDERS = {
    # in which order a file's axes run, outer one first: the upright picture as it is stored
    f"-Y {HEIGHT} +X {WIDTH}": lambda p: p,
    f"+Y {HEIGHT} +X {WIDTH}": lambda p: p[::-1],
    f"-Y {HEIGHT} -X {WIDTH}": lambda p: p[:, ::-1],
    f"+Y {HEIGHT} -X {WIDTH}": lambda p: p[::-1, ::-1],
    f"+X {WIDTH} -Y {HEIGHT}": lambda p: p.swapaxes(0, 1),
    f"-X {WIDTH} -Y {HEIGHT}": lambda p: p.swapaxes(0, 1)[::-1],
    f"+X {WIDTH} +Y {HEIGHT}": lambda p: p.swapaxes(0, 1)[:, ::-1],
    f"-X {WIDTH} +Y {HEIGHT}": lambda p: p.swapaxes(0, 1)[::-1, ::-1],
}


@pytest.mark.parametrize("resolution", ORDERS)
def test_a_radiance_file_is_read_in_its_order(tmp_path, resolution):
    upright = exact()
    path = hdr(tmp_path / "a.hdr", ORDERS[resolution](upright), resolution=resolution)
    np.testing.assert_array_equal(radiance(path), upright)
    assert RadianceMap.read(path).texels.shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_exr_is_read_in_the_orientation_that_it_states(tmp_path, orientation):
    """EXIF's numbers: where its first row and its first column are."""
    upright = sky()
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.swapaxes(0, 1),
        6: upright[:, ::-1].swapaxes(0, 1),  # its first row is the right-hand side, its first column the top
        7: upright[::-1, ::-1].swapaxes(0, 1),
        8: upright[::-1].swapaxes(0, 1),  # its first row is the left-hand side, its first column the bottom
    }[orientation]
    path = one(tmp_path / "a.exr", stored, Orientation=orientation)
    np.testing.assert_array_equal(radiance(path), upright)


def test_exposures_and_corrections_are_divided_out(tmp_path):
    """They say by what the pixels were multiplied, and add up (Ward)."""
    lines = ("EXPOSURE=4.0", "SOFTWARE=a tool", "EXPOSURE= 0.5", "COLORCORR=1 2 0.5", "\tEXPOSURE=64")
    found = radiance(hdr(tmp_path / "a.hdr", exact(), *lines))
    np.testing.assert_array_equal(found, exact() / np.float32([2.0, 4.0, 1.0]))
    found = radiance(hdr(tmp_path / "a.hdr", exact(), "EXPOSURE=2", ending="\r\n"))
    np.testing.assert_array_equal(found, exact() / 2)


def test_the_primaries_of_a_radiance_file_are_converted(tmp_path):
    line = f"PRIMARIES={' '.join(map(str, ACESCG))}"
    found = radiance(hdr(tmp_path / "a.hdr", exact(), line, "EXPOSURE=2"))
    expected = radiance(one(tmp_path / "a.exr", exact() / 2, chromaticities=ACESCG))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    for line in ("PRIMARIES=0 0 0 0 0 0 0 0", "PRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329", "GAMMA=1"):
        np.testing.assert_array_equal(radiance(hdr(tmp_path / "a.hdr", exact(), line)), exact())


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("EXPOSURE=bright", "'EXPOSURE=bright'"),
        ("EXPOSURE=0", "'EXPOSURE=0'"),
        ("EXPOSURE=-2", "'EXPOSURE=-2'"),
        ("COLORCORR=1 1", "'COLORCORR=1 1'"),
        ("PRIMARIES=0.3 0.3", "'PRIMARIES=0.3 0.3'"),
        ("PRIMARIES=.3 .3 .3 .3 .3 .3 .3 .3", "span no triangle"),
        ("GAMMA=2.2", "GAMMA=2.2"),
    ],
)
def test_a_radiance_header_that_cannot_be_followed_is_refused(tmp_path, line, found):
    path = hdr(tmp_path / "a.hdr", exact(), line)
    with pytest.raises(UserError, match=found) as caught:
        radiance(path)
    assert str(path) in str(caught.value)


# values


@pytest.mark.parametrize("kind", [oiio.HALF, oiio.FLOAT])
def test_a_sun_beyond_half_floats_is_the_largest_of_them(tmp_path, caplog, kind):
    pixels = sky()
    pixels[4, 9] = [np.inf, 60000.0, np.inf]
    with caplog.at_level(logging.WARNING):
        found = radiance(one(tmp_path / "a.exr", pixels, kind=kind))
    np.testing.assert_array_equal(found[4, 9], [HALF_MAX, 60000.0, HALF_MAX])
    assert float(np.float16(HALF_MAX)) == HALF_MAX
    assert np.isfinite(found).all()
    (record,) = caplog.records
    assert f"2 of {pixels.size} values are infinite" in record.getMessage()
    light = Environment.load(tmp_path / "a.exr", size=16)
    assert light.specular.isfinite().all()


def test_infinite_light_all_over_is_refused(tmp_path):
    pixels = sky()
    count = int(MOST_INFINITE * pixels.size) + 1
    pixels.reshape(-1)[:count] = np.inf
    with pytest.raises(UserError, match=f"{count} of {pixels.size} values that are infinite or not numbers"):
        radiance(one(tmp_path / "a.exr", pixels))


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_what_is_no_number_is_refused(tmp_path, value):
    pixels = sky()
    pixels[4, 9, 1] = value
    with pytest.raises(UserError, match=f"1 of {pixels.size} values that are infinite or not numbers"):
        radiance(one(tmp_path / "a.exr", pixels, kind=oiio.HALF))


def test_negative_radiance_is_said_once_and_taken_for_none(tmp_path, caplog):
    """A resampled sun has dark rings: how many values, and how dark the darkest is."""
    pixels = sky()
    pixels[3, 7:10, 0] = [-0.25, -2.5, -1.0]
    with caplog.at_level(logging.WARNING):
        found = radiance(one(tmp_path / "a.exr", pixels))
    np.testing.assert_array_equal(found, np.maximum(pixels, 0))
    (record,) = caplog.records
    message = f"{tmp_path / 'a.exr'}: 3 of {pixels.size} values are negative, down to -2.5, and taken for 0"
    assert record.getMessage() == message


@pytest.mark.parametrize("name", ["a.hdr", "a.exr", "tiles.exr", "a.tif"])
def test_a_light_file_that_was_cut_is_refused(tmp_path, name):
    pixels = np.random.default_rng(0).random((128, 256, 3)).astype(np.float32)
    path = one(tmp_path / name, pixels, tile=32 if name == "tiles.exr" else 0)
    whole = path.read_bytes()
    for cut in np.linspace(0, len(whole) - 1, 16).astype(int):
        path.write_bytes(whole[:cut])
        with pytest.raises(UserError, match=name):
            radiance(path)


def test_ordinary_light_is_read_without_a_word(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        radiance(one(tmp_path / "a.exr", sky()))
        radiance(hdr(tmp_path / "a.hdr", exact(), "EXPOSURE=2"))
    assert not caplog.records


@pytest.mark.parametrize(("height", "width", "size"), [(64, 128, 16), (60, 120, 32), (33, 66, 64)])
def test_light_around_a_sun_is_never_negative(tmp_path, height, width, size):
    """Neither of the resampling to a cubemap, of the filters nor of the picture behind a head."""
    pixels = np.zeros((height, width, 3), np.float32)
    pixels[height // 4, width // 3] = HALF_MAX
    light = Environment.load(one(tmp_path / "a.exr", pixels), size=size)
    filtered = light.filtered()
    assert light.specular.min() >= 0
    assert filtered.irradiance.min() >= 0
    assert min(mip.min() for mip in filtered.specular) >= 0
    directions = torch.nn.functional.normalize(torch.randn(20_000, 3, generator=torch.Generator()), dim=-1)
    assert light.visible.look(directions).min() >= 0


def test_blocks_of_rows_are_joined(tmp_path, monkeypatch):
    """A large map is decoded in blocks: here of three rows, and of a row of tiles."""
    monkeypatch.setattr("samira_warp.io.decoding._BLOCK_VALUES", 3 * WIDTH * 3)
    pixels = sky()
    for tile in (0, 16):
        found = radiance(one(tmp_path / "a.exr", pixels[1:], tile=tile, window=(0, 1), Orientation=3))
        np.testing.assert_array_equal(found[:-1], pixels[1:][::-1, ::-1])
    levels = (255 * sky() / sky().max()).astype(np.uint8)
    path = one(tmp_path / "a.png", levels, kind=oiio.UINT8)
    display = encode_srgb(torch.from_numpy(radiance(path, ldr=True)))
    np.testing.assert_allclose(display, levels / 255, atol=1e-6)


LOADED = """
import re, sys
from pathlib import Path
from samira_warp.light import Environment

def peak():
    return 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

before = peak()
Environment.load(sys.argv[1], size=64, exposure=2.0)
print(loaded := peak() - before)
Environment.load(sys.argv[1], size=64, exposure=2.0).display_map()
print(peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_large_map_needs_little_more_memory_than_it_has_pixels(tmp_path):
    """Its pixels as floats, and blocks that are decoded, weighted and encoded: no copy of it as a whole."""
    height, width = 4096, 8192
    spec = oiio.ImageSpec(width, height, 3, oiio.HALF)
    spec.attribute("compression", "none")
    output, path = oiio.ImageOutput.create("a.exr"), str(tmp_path / "a.exr")
    assert output.open(path, spec)
    rows = np.ones((256, width, 3), np.float32)
    for first in range(0, height, 256):
        assert output.write_scanlines(first, first + 256, 0, rows)
    assert output.close()
    done = subprocess.run([sys.executable, "-c", LOADED, path], capture_output=True, text=True, check=True)
    loaded, shown = (int(peak) / (4 * 3 * height * width) for peak in done.stdout.split())
    assert 1.0 < loaded < 1.7
    # blocks that several threads hold at a time, and no third copy of the whole
    assert 2.0 < shown < 3.0
