"""Pictures that only seem whole are refused by name; pictures that are whole but unusual are read."""

import io
import struct

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import pytest
from PIL import Image

from samira_warp.io.images import image_size, read_image, read_rgba
from samira_warp.support.errors import UserError

HEIGHT, WIDTH = 72, 104


def picture():
    """Slopes and noise: no row is like another, and no codec gets it for nothing."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    slopes = np.stack([2 * columns, 3 * rows, rows + columns], axis=-1)
    noise = np.random.default_rng(0).normal(0, 12, slopes.shape)
    return np.clip(slopes + noise, 0, 255).astype(np.uint8)


def by_pillow(kind, mode="RGB", **options):
    buffer = io.BytesIO()
    Image.fromarray(picture()).convert(mode).save(buffer, kind, **options)
    return buffer.getvalue()


def by_oiio(path, kind=oiio.HALF, *, tile=0, **attributes):
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, kind)
    spec.tile_width = spec.tile_height = tile
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(picture() if kind == oiio.UINT8 else picture() / np.float32(64))
    assert output.close()
    return path.read_bytes()


PILLOW = {
    "a.jpg": ("JPEG", {}),
    "progressive.jpg": ("JPEG", {"progressive": True}),
    "restarts.jpg": ("JPEG", {"restart_marker_blocks": 3}),
    "grey.jpg": ("JPEG", {"mode": "L"}),
    "cmyk.jpg": ("JPEG", {"mode": "CMYK"}),
    "a.webp": ("WEBP", {}),
    "lossless.webp": ("WEBP", {"lossless": True}),
    "alpha.webp": ("WEBP", {"mode": "RGBA"}),
    "a.png": ("PNG", {}),
    "palette.png": ("PNG", {"mode": "P"}),
    "a.bmp": ("BMP", {}),
    "a.gif": ("GIF", {"mode": "P"}),
    "a.ppm": ("PPM", {}),
    "a.tif": ("TIFF", {}),
    "lzw.tif": ("TIFF", {"compression": "tiff_lzw"}),
    "zip.tif": ("TIFF", {"compression": "tiff_adobe_deflate"}),
    "jpeg.tif": ("TIFF", {"compression": "jpeg"}),
}
COMPRESSIONS = ("none", "rle", "zip", "zips", "piz", "pxr24", "b44", "dwaa")
OIIO = {
    "a.hdr": (oiio.FLOAT, {}),
    "tiles.tif": (oiio.UINT8, {"tile": 16}),
    **{f"{name}.exr": (oiio.HALF, {"compression": name}) for name in COMPRESSIONS},
    **{f"tiles_{name}.exr": (oiio.HALF, {"compression": name, "tile": 32}) for name in COMPRESSIONS},
}


def written(path):
    if path.name in PILLOW:
        kind, options = PILLOW[path.name]
        path.write_bytes(by_pillow(kind, **options))
        return path.read_bytes()
    kind, options = OIIO[path.name]
    return by_oiio(path, kind, **options)


def refused(path, content, read=lambda path: read_image(path, channels=3)):
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", [*PILLOW, *OIIO])
def test_a_file_that_is_cut_anywhere_is_refused(tmp_path, name):
    whole = written(tmp_path / name)
    before = read_rgba(tmp_path / name)[0] if name != "cmyk.jpg" else None
    last = len(whole) - (1 if name.endswith(".gif") else 0)  # a GIF's last byte only says that it ends
    cuts = {*np.linspace(0, last - 1, 24).astype(int).tolist(), *range(last - 4, last)}
    for cut in sorted(cuts):
        refused(tmp_path / f"cut_{name}", whole[:cut])
    if before is not None:  # nothing of the faults lingers
        np.testing.assert_array_equal(read_rgba(tmp_path / name)[0], before)


@pytest.mark.parametrize("name", ["a.jpg", "progressive.jpg", "restarts.jpg", "a.webp", "a.png", "lzw.tif"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_a_file_whose_end_was_never_written_is_refused(tmp_path, name, share):
    """As long as it should be, and zeros at its end: a full disk, or a copy that broke off."""
    whole = written(tmp_path / name)
    kept = int(share * len(whole))
    refused(tmp_path / f"zeros_{name}", whole[:kept] + bytes(len(whole) - kept))


def test_a_jpeg_that_was_cut_and_closed_is_refused(tmp_path):
    """Repair tools put the mark of the end after what there is."""
    whole = by_pillow("JPEG")
    for share in (0.4, 0.6, 0.9):
        refused(tmp_path / "a.jpg", whole[: int(share * len(whole))] + b"\xff\xd9")


def test_a_progressive_jpeg_without_its_last_scans_is_refused(tmp_path):
    """It decodes without a word to a picture that is blurred."""
    whole = by_pillow("JPEG", progressive=True)
    scans = [at for at in range(len(whole)) if whole[at : at + 2] == b"\xff\xda"]
    assert len(scans) > 5
    for scan in scans[1:]:
        # tables stand before a scan; those of one that is missing do no harm
        message = refused(tmp_path / "a.jpg", whole[:scan] + b"\xff\xd9")
        assert "scans missing for" in message


def test_a_jpeg_of_which_a_component_is_missing_is_refused(tmp_path):
    """Three scans of a component each, as `jpegtran` writes them; the last is taken away."""
    components = [bytes([1, 0x11, 0]), bytes([2, 0x11, 0]), bytes([3, 0x11, 0])]
    grey = by_pillow("JPEG", "L")
    frame, tables, scan = grey.index(b"\xff\xc0"), grey.index(b"\xff\xc4"), grey.index(b"\xff\xda")
    size = grey[frame + 4 : frame + 9]
    head = grey[:frame] + b"\xff\xc0\x00\x11" + size + b"\x03" + b"".join(components)
    coded = grey[scan + 10 : -2]
    scans = [b"\xff\xda\x00\x08\x01" + bytes([number, 0, 0, 63, 0]) + coded for number in (1, 2, 3)]
    path = tmp_path / "a.jpg"
    path.write_bytes(head + grey[tables:scan] + b"".join(scans) + b"\xff\xd9")
    assert read_image(path, channels=3).shape == (HEIGHT, WIDTH, 3)
    message = refused(path, head + grey[tables:scan] + b"".join(scans[:2]) + b"\xff\xd9")
    assert "scans missing for 1 of its 3 components" in message


def test_a_jpeg_in_which_another_begins_is_refused(tmp_path):
    whole = by_pillow("JPEG")
    assert "another picture's start" in refused(tmp_path / "a.jpg", whole[: len(whole) // 2] + whole)


def test_a_tiff_with_strips_that_were_never_written_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("PIL.TiffImagePlugin.STRIP_SIZE", 4096)
    whole = bytearray(by_pillow("TIFF", compression="packbits"))
    (directory,) = struct.unpack_from("<I", whole, 4)
    (entries,) = struct.unpack_from("<H", whole, directory)
    places = {}
    for number in range(entries):
        tag, kind, count, place = struct.unpack_from("<HHII", whole, directory + 2 + 12 * number)
        places[tag] = kind, count, place
    for tag in (273, 279):
        kind, count, place = places[tag]
        size = {3: 2, 4: 4}[kind]
        assert count > 1
        whole[place + (count - 1) * size : place + count * size] = bytes(size)
    assert f"1 of {places[273][1]} strips never written" in refused(tmp_path / "a.tif", bytes(whole))


def test_the_size_of_a_cut_picture_is_read(tmp_path):
    """Lists of frames are checked against headers alone."""
    (tmp_path / "a.jpg").write_bytes(by_pillow("JPEG")[:-100])
    assert image_size(tmp_path / "a.jpg") == (WIDTH, HEIGHT)


def segment(number, body):
    return bytes([0xFF, number]) + struct.pack(">H", len(body) + 2) + body


def bad_scan_header(whole):
    """Values that a sequential JPEG has no use for, which some cameras fill with anything."""
    start = whole.index(b"\xff\xda")
    length = int.from_bytes(whole[start + 2 : start + 4], "big")
    changed = bytearray(whole)
    changed[start + length] = 5
    return bytes(changed)


UNUSUAL_JPEGS = {
    "text behind it": lambda whole: whole + b"notes of an editor" * 9,
    "zeros behind it": lambda whole: whole + bytes(4096),
    "a second picture behind it (MPO)": lambda whole: whole + whole,
    "half a second picture behind it": lambda whole: whole + whole[: len(whole) // 2],
    "a thumbnail in its EXIF": lambda whole: (
        whole[:2] + segment(0xE1, b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0" + by_pillow("JPEG")) + whole[2:]
    ),
    "half a thumbnail in its EXIF": lambda whole: (
        whole[:2] + segment(0xE1, b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0" + whole[:600]) + whole[2:]
    ),
    "an end and a start within a comment": lambda whole: (
        whole[:2] + segment(0xFE, b"\xff\xd9\xff\xd8") + whole[2:]
    ),
    "filled up before its end": lambda whole: whole[:-2] + b"\xff" * 5 + whole[-2:],
    "stray bytes before its end": lambda whole: whole[:-2] + b"\0" + whole[-2:],
    "stray bytes before its tables": lambda whole: whole.replace(b"\xff\xc4", b"\x12\x34\xff\xc4", 1),
    "a scan's header of another kind": bad_scan_header,
}


@pytest.mark.parametrize(
    ("name", "progressive"),
    [
        (name, progressive)
        for name in UNUSUAL_JPEGS
        for progressive in (False, True)
        if not (progressive and UNUSUAL_JPEGS[name] is bad_scan_header)
    ],
)
def test_an_unusual_jpeg_is_read(tmp_path, name, progressive):
    whole = by_pillow("JPEG", progressive=progressive)
    (tmp_path / "a.jpg").write_bytes(whole)
    expected = read_image(tmp_path / "a.jpg", channels=3)
    changed = UNUSUAL_JPEGS[name](whole)
    assert changed != whole
    (tmp_path / "a.jpg").write_bytes(changed)
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg", channels=3), expected)


@pytest.mark.parametrize("name", ["a.webp", "lossless.webp", "a.png", "a.tif", "a.bmp", "a.gif"])
def test_what_follows_a_picture_is_no_fault(tmp_path, name):
    path = tmp_path / name
    whole = written(path)
    expected = read_image(path, channels=3)
    path.write_bytes(whole + b"notes of an editor" + bytes(100))
    np.testing.assert_array_equal(read_image(path, channels=3), expected)


@pytest.mark.parametrize(("name", "other"), [("a.jpg", ".png"), ("a.png", ".jpg"), ("a.webp", ".jpg")])
def test_a_file_of_another_kind_than_its_name_says_is_checked_as_what_it_is(tmp_path, name, other):
    whole = written(tmp_path / name)
    path = tmp_path / f"b{other}"
    path.write_bytes(whole)
    assert read_image(path, channels=3).shape == (HEIGHT, WIDTH, 3)
    refused(path, whole[: 2 * len(whole) // 3])


def test_a_file_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.jpg").write_bytes(by_pillow("JPEG"))

    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", forbidden)
    with pytest.raises(UserError, match=r"a\.jpg.*Permission denied"):
        read_image(tmp_path / "a.jpg", channels=3)
