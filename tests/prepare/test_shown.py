"""Videos as phones, cameras and editors write them.

They are held to what FFmpeg's own program shows, and to the standards' formulas.
"""

import itertools
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest

from samira_warp.data.video import read_facts, read_pictures
from samira_warp.io.images import read_image
from samira_warp.support.errors import UserError

SKIN = np.array([(200, 150, 120), (90, 60, 50), (200, 40, 40), (128, 128, 128), (40, 90, 160)])
"""sRGB display values below the light that is compressed."""


def ffmpeg(*arguments):
    subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y", *map(str, arguments)], check=True
    )


def pictures(path):
    return [picture.pixels() for picture in read_pictures(path)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("shown")


@pytest.fixture(scope="module")
def noise(folder):
    """Four seconds that do not compress, a key picture every fifth."""
    path = folder / "noise.mp4"
    ffmpeg(
        "-f",
        "lavfi",
        "-i",
        "nullsrc=s=64x48:d=4:r=25,geq=random(1)*255:128:128",
        "-g",
        5,
        "-movflags",
        "faststart",
        path,
    )
    return path


# --- edit lists, empty slots, and what is really cut off


def test_a_trimmed_film_is_whole(folder):
    ffmpeg(
        "-f", "lavfi", "-i", "testsrc=d=8:r=25:s=64x48", "-g", 250, "-pix_fmt", "yuv420p", folder / "long.mp4"
    )
    ffmpeg("-ss", 5.6, "-i", folder / "long.mp4", "-t", 1, "-c", "copy", folder / "trim.mp4")
    ffmpeg("-i", folder / "trim.mp4", "-fps_mode", "passthrough", folder / "trim%03d.png")
    shown = [read_image(path, channels=3) * 255 for path in sorted(folder.glob("trim*.png"))]
    assert len(shown) > 20
    found = pictures(folder / "trim.mp4")
    assert len(found) == len(shown)
    assert max(np.abs(a - b).mean() for a, b in zip(found, shown, strict=True)) < 1.0
    assert abs(read_facts(folder / "trim.mp4").count - len(shown)) <= 0.1 * len(shown)  # it is an estimate


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi"])
def test_a_film_of_uneven_rate_is_whole(folder, suffix):
    path = folder / f"uneven.{suffix}"
    source = "testsrc=d=4:r=25:s=64x48,select='not(between(n,10,70))'"
    ffmpeg("-f", "lavfi", "-i", source, "-fps_mode", "vfr", "-c:v", "mpeg4", path)
    assert len(pictures(path)) == 39
    times = [picture.seconds for picture in read_pictures(path)]
    assert times[9:11] == pytest.approx([9 / 25, 71 / 25], abs=2e-3)


def test_a_film_that_begins_late_or_ends_before_its_sound_is_whole(folder, noise):
    ffmpeg(
        "-itsoffset",
        3,
        "-i",
        noise,
        "-f",
        "lavfi",
        "-i",
        "sine=d=20",
        "-map",
        0,
        "-map",
        1,
        "-c:v",
        "copy",
        folder / "late.mp4",
    )
    assert len(pictures(folder / "late.mp4")) == 100


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi"])
def test_a_film_without_its_end_is_refused(folder, noise, suffix):
    whole, cut = folder / f"whole.{suffix}", folder / f"cut.{suffix}"
    codec = ("-c:v", "mpeg4", "-q:v", 3) if suffix == "avi" else ("-c", "copy")
    ffmpeg("-i", noise, *codec, "-movflags", "faststart", whole)
    assert len(pictures(whole)) == 100
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(UserError, match=" after "):
        pictures(cut)


# --- which way up


@pytest.mark.parametrize(
    ("degrees", "flips"),
    list(itertools.product((0, 90, 180, 270), ((), ("-display_hflip",), ("-display_vflip",)))),
)
def test_films_are_turned_and_mirrored_as_players_do(folder, degrees, flips):
    """All eight ways, three of them twice; front cameras mirror."""
    plain, turned = folder / "plain.mp4", folder / f"turned{degrees}{''.join(flips)}.mp4"
    if not plain.is_file():
        ffmpeg("-f", "lavfi", "-i", "testsrc=d=0.1:r=25:s=64x48", "-pix_fmt", "yuv444p", "-crf", 2, plain)
    ffmpeg("-display_rotation", degrees, *flips, "-i", plain, "-c", "copy", turned)
    ffmpeg("-i", turned, "-frames:v", 1, turned.with_suffix(".png"))
    expected = read_image(turned.with_suffix(".png"), channels=3) * 255
    found = pictures(turned)[0]
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() <= 3.0  # conversions of another order round otherwise


# --- pixels that are not square, and pictures that change their size


def extent(picture):
    """Width and height of what is light."""
    light = picture[..., 1] > 125
    return int(light.any(axis=0).sum()), int(light.any(axis=1).sum())


@pytest.mark.parametrize(
    ("width", "height", "aspect"), [(176, 176, "16/11"), (176, 96, "1/2"), (128, 128, "1/1")]
)
@pytest.mark.parametrize("degrees", [0, 90])
def test_a_disc_is_round(folder, width, height, aspect, degrees):
    across, down = (int(part) for part in aspect.split("/"))
    disc = f"255*lt(hypot((X-{width / 2})*{across / down},Y-{height / 2}),40)"
    path, turned = folder / "square.mp4", folder / "square turned.mp4"
    ffmpeg(
        "-f", "lavfi", "-i", f"nullsrc=s={width}x{height}:d=0.1:r=25,"
        f"geq=lum='{disc}':cb=128:cr=128,setsar={aspect}", path
    )  # fmt: skip
    ffmpeg("-display_rotation", degrees, "-i", path, "-c", "copy", turned)
    found = pictures(turned)[0]
    shown = (width * max(1, across / down), height * max(1, down / across))
    assert found.shape[:2] == tuple(round(side) for side in (shown if degrees else shown[::-1]))
    wide, high = extent(found)
    assert abs(wide - high) <= 3  # an edge lies within a pixel on either side
    facts = read_facts(turned)
    assert (facts.width, facts.height) == found.shape[1::-1]


def _stream(path, *sizes):
    """One H.264 stream of 5 pictures of each size, as calls over a network are recorded."""
    parts = []
    for number, size in enumerate(sizes):
        part = path.with_suffix(f".{number}.h264")
        ffmpeg("-f", "lavfi", "-i", f"testsrc=d=0.2:r=25:s={size}", "-pix_fmt", "yuv420p", part)
        parts.append(part.read_bytes())
    path.write_bytes(b"".join(parts))
    return path


def test_pictures_that_change_their_size_keep_that_of_the_first(folder):
    found = pictures(_stream(folder / "call.h264", "128x96", "64x48", "256x192"))
    assert [picture.shape for picture in found] == [(96, 128, 3)] * 15
    # the same picture, smaller and larger: the test chart's colours stay where they are
    assert np.abs(found[0][::8, ::8].astype(float) - found[10][::8, ::8]).mean() < 12.0


def test_pictures_that_change_their_shape_are_refused(folder):
    with pytest.raises(UserError, match="pictures of one shape, 128 x 96 as the first"):
        pictures(_stream(folder / "turned call.h264", "128x96", "96x128"))


# --- colours


def linear(display):
    display = display / 255.0
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def hlg(light):
    """ITU-R BT.2100's opto-electronic transfer of scene light whose diffuse white lies at 75 % (BT.2408)."""
    e = 0.265 * light
    return np.where(
        e <= 1 / 12, np.sqrt(3 * e), 0.17883277 * np.log(np.maximum(12 * e - 0.28466892, 1e-6)) + 0.55991073
    )


def pq(light):
    """SMPTE ST 2084's of light whose diffuse white is 203 cd/m^2."""
    y = (203 * light / 10_000) ** (2610 / 16384)
    return ((3424 / 4096 + 2413 / 128 * y) / (1 + 2392 / 128 * y)) ** (2523 / 32)


def srgb(light):
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


TO_2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
"""BT.709's light to BT.2020's (ITU-R BT.2087)."""
TO_P3 = np.array([[0.8225, 0.1774, 0.0], [0.0332, 0.9669, 0.0], [0.0171, 0.0724, 0.9108]])
"""BT.709's light to Display P3's."""

COLOURS = {
    "HLG": (hlg, TO_2020, "bt2020", "arib-std-b67", "bt2020nc"),
    "PQ": (pq, TO_2020, "bt2020", "smpte2084", "bt2020nc"),
    "wide gamut": (srgb, TO_2020, "bt2020", "bt2020-10", "bt2020nc"),
    "P3": (srgb, TO_P3, "smpte432", "bt709", "bt709"),
    "ordinary": (srgb, np.eye(3), "bt709", "bt709", "bt709"),
}


@pytest.mark.parametrize("name", COLOURS)
def test_skin_is_of_its_colour(folder, name):
    encode, matrix, primaries, transfer, coefficients = COLOURS[name]
    signal = encode(linear(SKIN) @ matrix.T)
    picture = np.repeat(np.rint(signal * 65535).astype("<u2"), 64, axis=0)[None].repeat(64, axis=0)
    (folder / "colours.rgb").write_bytes(picture.tobytes())
    path, width = folder / f"{name}.mkv", 64 * len(SKIN)
    ffmpeg(
        "-f", "rawvideo", "-pix_fmt", "rgb48le", "-s", f"{width}x64", "-r", 25, "-i", folder / "colours.rgb",
        "-vf", f"scale=out_color_matrix={coefficients.removesuffix('nc')}:out_range=tv,format=yuv420p10le,"
        f"setparams=color_primaries={primaries}:color_trc={transfer}:colorspace={coefficients}",
        "-c:v", "ffv1", path,
    )  # fmt: skip
    found = pictures(path)[0].reshape(64, len(SKIN), 64, 3)[16:48, :, 16:48].mean(axis=(0, 2))
    # a step of the 10-bit signal is up to 2 levels of 255 where the curves are steepest apart, and the matrix
    # of YCbCr adds up to three of them
    assert np.abs(found - SKIN).max() <= 5.0
    assert read_facts(path).dynamic_range == (name if name in ("HLG", "PQ") else None)


def test_light_beyond_white_is_compressed_in_order(folder):
    """Lamps in a film of high dynamic range are bright, and brighter lamps are brighter."""
    light = np.array([0.5, 1.0, 1.5, 2.0, 3.0])[:, None] * np.ones(3)
    picture = np.repeat(np.rint(hlg(light) * 65535).astype("<u2"), 64, axis=0)[None].repeat(64, axis=0)
    (folder / "lamps.rgb").write_bytes(picture.tobytes())
    ffmpeg(
        "-f", "rawvideo", "-pix_fmt", "rgb48le", "-s", "320x64", "-r", 25, "-i", folder / "lamps.rgb", "-vf",
        "scale=out_color_matrix=bt2020:out_range=tv,format=yuv420p10le,setparams=color_primaries=bt2020:"
        "color_trc=arib-std-b67:colorspace=bt2020nc", "-c:v", "ffv1", folder / "lamps.mkv",
    )  # fmt: skip
    row = pictures(folder / "lamps.mkv")[0][32, 32::64, 1].astype(int)
    assert row[0] == pytest.approx(255 * srgb(0.5), abs=2)
    assert (np.diff(row) > 0).all()
    assert row[-1] <= 255


@pytest.mark.parametrize(
    ("size", "matrix"),
    [("1280x720", "bt709"), ("640x480", "bt601"), ("720x576", "bt601"), ("608x1080", "bt709")],
)
def test_films_without_a_tag_are_read_by_their_size(folder, size, matrix):
    path, raw = folder / f"untagged {size}.mkv", folder / "untagged.rgb"
    width, height = (int(side) for side in size.split("x"))
    raw.write_bytes(np.full((height, width, 3), (200, 150, 125), np.uint8).tobytes())
    ffmpeg(
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", 25, "-i", raw, "-vf",
        f"scale=out_color_matrix={matrix}:out_range=tv,format=yuv420p,setparams=color_primaries=unknown:"
        "color_trc=unknown:colorspace=unknown", "-c:v", "ffv1", path,
    )  # fmt: skip
    # the scaler loses up to 2 levels; the other matrix is 4 off in red, to the other side for HD
    assert np.abs(pictures(path)[0].mean(axis=(0, 1)) - (200, 150, 125)).max() <= 2.0


def test_colours_that_nobody_here_reads_are_refused_by_name(folder):
    path = folder / "ictcp.mkv"
    ffmpeg(
        "-f", "lavfi", "-i", "color=s=64x64:d=0.1:r=25",
        "-vf", "format=yuv420p10le,setparams=colorspace=ictcp", "-c:v", "ffv1", path,
    )  # fmt: skip
    with pytest.raises(UserError, match="ICtCp"):
        pictures(path)
