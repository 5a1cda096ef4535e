"""Image files in and out, all through OpenImageIO, and the two ways of changing an image's size."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
from PIL import Image

from samira_warp.io.decoding import decode, opened, picture_size, utf8_name
from samira_warp.io.whole import check_whole
from samira_warp.support.errors import UserError

_FONT_SHARE, _BASELINE = 0.75, 0.75
"""Size of letters in a line of text, and where they stand, as shares of its height: room for what hangs
below."""


class Channels(NamedTuple):
    """A file's channels as they are stored.

    Attributes:
        pixels: (H, W, C) float32: display values in 0..1 of files of whole numbers, the stored values of
            floating-point files.
        names: C names, such as R, G, B, A.
        full_scale: The whole number that 1 stands for, 255 or 65535; 0 of floating-point files.
    """

    pixels: np.ndarray
    names: tuple[str, ...]
    full_scale: int


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels of an image as it is shown, upright, from the header alone.

    Raises:
        UserError: The file is missing or its header is not an image's.
    """
    with opened(path, whole=False) as image:
        return picture_size(image, path)


def is_linear(path: Path) -> bool:
    """Whether a file holds floating-point values, which are linear radiance, from the header alone.

    Raises:
        UserError: The file is missing or its header is not an image's.
    """
    with opened(path, whole=False) as image:
        return holds_floats(image.spec())


def has_alpha(path: Path) -> bool:
    """Whether a file has an alpha channel, from the header alone.

    Raises:
        UserError: The file is missing or its header is not an image's.
    """
    with opened(path, whole=False) as image:
        return image.spec().alpha_channel >= 0


def holds_floats(spec: oiio.ImageSpec) -> bool:
    """Whether the pixels that a header describes are floating-point values."""
    return spec.format.basetype in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)


def read_image(path: Path, *, channels: Literal[1, 3]) -> np.ndarray:
    """An image's colour, without its alpha.

    Grey is repeated where 3 channels are wanted; colour is averaged where 1 is wanted.

    Args:
        path: Any file that OpenImageIO reads.
        channels: How many channels to return.

    Returns:
        (H, W, channels) float32: display values in 0..1 of 8- and 16-bit files, linear radiance of .hdr and
        .exr.

    Raises:
        UserError: The file is missing or cannot be decoded.
    """
    colour, _ = _read_colour_and_alpha(path)
    if channels == 1:
        return colour.mean(axis=2, keepdims=True)
    return np.repeat(colour, 3, axis=2) if colour.shape[2] == 1 else colour


def read_channels(path: Path) -> Channels:
    """Every channel of an image by name.

    Raises:
        UserError: The file is missing or cannot be decoded.
    """
    with opened(path, whole=True) as image:
        spec = image.spec()
        full_scale = 0 if holds_floats(spec) else 2 ** (8 * spec.format.basesize()) - 1
        return Channels(decode(image, path, oiio.FLOAT), tuple(spec.channelnames), full_scale)


def read_rgba(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """An image's straight colour (H, W, 3) and its alpha (H, W) in 0..1, both float32.

    The alpha is None where the file has none.

    Raises:
        UserError: The file is missing or cannot be decoded.
    """
    colour, alpha = _read_colour_and_alpha(path)
    return (np.repeat(colour, 3, axis=2) if colour.shape[2] == 1 else colour), alpha


def composite_on_white(colour: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Straight colour (H, W, 3) under coverage (H, W) laid on white.

    It is laid in display values, as the mattes of these datasets are made.
    """
    coverage = alpha[..., None]
    return colour * coverage + (1.0 - coverage)


def read_on_white(path: Path) -> np.ndarray:
    """(H, W, 3) float32 colour of a file, laid on white where it has an alpha channel.

    Raises:
        UserError: The file is missing or cannot be decoded.
    """
    colour, alpha = read_rgba(path)
    return colour if alpha is None else composite_on_white(colour, alpha)


def read_labels(path: Path) -> np.ndarray:
    """(H, W) uint8 labels of an 8-bit grey file.

    Raises:
        UserError: The file is missing, cannot be decoded, or is not 8-bit grey.
    """
    with opened(path, whole=True) as image:
        spec = image.spec()
        if spec.nchannels != 1 or spec.format != oiio.TypeDesc(oiio.UINT8):
            raise UserError(
                path, expected="8-bit grey labels", found=f"{spec.nchannels} channels of {spec.format}"
            )
        return decode(image, path, oiio.UINT8)[..., 0]


def write_png(path: Path, array: np.ndarray) -> None:
    """Write display values as an 8-bit PNG, clipped to 0..1, or whole numbers as they are.

    Args:
        path: Where to; its folder must exist.
        array: (H, W), (H, W, 1), (H, W, 3) or, with straight alpha, (H, W, 4) floats in 0..1, or uint8
            or uint16.

    Raises:
        OSError: The file cannot be written.
    """
    if array.dtype == np.uint16:
        _write(path, array, oiio.UINT16)
    else:
        _write(path, array if array.dtype == np.uint8 else to_uint8(array), oiio.UINT8)


def write_exr(path: Path, array: np.ndarray) -> None:
    """Write (H, W), (H, W, 1) or (H, W, 3) values unclipped as a 32-bit float EXR.

    Raises:
        OSError: The file cannot be written.
    """
    _write(path, array.astype(np.float32, copy=False), oiio.FLOAT)


def encode_png(array: np.ndarray) -> bytes:
    """(H, W, 3) uint8 as the bytes of a PNG file."""
    file = io.BytesIO()
    Image.fromarray(array).save(file, "PNG")
    return file.getvalue()


def to_uint8(array: np.ndarray) -> np.ndarray:
    """Display values in 0..1 rounded to the nearest of 256 levels, clipped."""
    return np.rint(np.clip(array, 0.0, 1.0) * 255.0).astype(np.uint8)


def resize_box(array: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """Exact area average: each new pixel is the mean of the image over the rectangle that it covers.

    Pixels cut by a border count by the share that lies inside, so any factor is exact, and so is the mean of
    the whole.

    Args:
        array: (H, W) or (H, W, C) floats.
        width: New width, pixels.
        height: New height, pixels.

    Returns:
        (height, width[, C]) of the same dtype; ``array`` itself where the size is already right.
    """
    rows, columns = array.shape[:2]
    if (columns, rows) == (width, height):
        return array
    if rows % height == 0 and columns % width == 0:
        tiles = array.reshape(height, rows // height, width, columns // width, *array.shape[2:])
        return tiles.mean(axis=(1, 3), dtype=array.dtype)
    by_rows = np.tensordot(_box_weights(rows, height, array.dtype), array, axes=(1, 0))
    return np.ascontiguousarray(
        np.moveaxis(np.tensordot(_box_weights(columns, width, array.dtype), by_rows, axes=(1, 1)), 0, 1)
    )


def resize_nearest(array: np.ndarray, *, width: int, height: int) -> np.ndarray:
    """The value at each new pixel's centre, for labels: (H, W, ...) -> (height, width, ...)."""
    rows = (np.arange(height) * 2 + 1) * array.shape[0] // (2 * height)
    columns = (np.arange(width) * 2 + 1) * array.shape[1] // (2 * width)
    return array[rows[:, None], columns[None, :]]


def text_line(text: str, *, width: int, height: int) -> np.ndarray:
    """(height, width, 3) float32: one line of black text in the middle of a white strip.

    What is too long loses its middle.
    """
    # The name of a file may hold bytes that the locale does not know.
    text = text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    strip = oiio.ImageBuf(oiio.ImageSpec(width, height, 3, oiio.FLOAT))
    oiio.ImageBufAlgo.fill(strip, (1.0, 1.0, 1.0))
    font_size = max(round(_FONT_SHARE * height), 1)
    shown, kept = text, len(text)
    while kept > 1 and oiio.ImageBufAlgo.text_size(shown, font_size).width > width:
        kept -= 1
        shown = f"{text[: (kept + 1) // 2]}...{text[len(text) - kept // 2 :]}"
    baseline = round(_BASELINE * height)
    oiio.ImageBufAlgo.render_text(
        strip, width // 2, baseline, shown, font_size, "", (0.0, 0.0, 0.0), "center", "baseline"
    )
    pixels = strip.get_pixels(oiio.FLOAT)
    if pixels is None:
        raise RuntimeError(strip.geterror())
    return pixels


def _box_weights(old: int, new: int, dtype: np.dtype) -> np.ndarray:
    """(new, old) share of each old cell in each new one; rows sum to 1."""
    edges = np.arange(new + 1) * (old / new)
    cells = np.arange(old)
    overlap = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    return (np.maximum(overlap, 0.0) * (new / old)).astype(dtype)


def _read_colour_and_alpha(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Straight colour (H, W, 1 or 3) and alpha (H, W) or None."""
    with opened(path, whole=True) as image:
        spec = image.spec()
        pixels = decode(image, path, oiio.FLOAT)
    alpha, number = None, spec.alpha_channel
    if number >= spec.nchannels:  # the GIF reader's
        number = spec.channelnames.index("A")
    if number >= 0:
        alpha = pixels[..., number]
        pixels = np.delete(pixels, number, axis=2)
        if not spec.get_int_attribute("oiio:UnassociatedAlpha"):
            pixels = _straight(pixels, alpha)
    if pixels.shape[2] not in (1, 3):
        raise UserError(
            path, expected="grey or RGB, with or without alpha", found=f"{pixels.shape[2]} colour channels"
        )
    return pixels, alpha


def _straight(colour: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Colours (H, W, C) that a file holds multiplied by alpha (H, W), as EXR does and TIFF may."""
    covered = alpha[..., None] > 0.0
    return np.where(covered, colour / np.where(covered, alpha[..., None], 1.0), colour).astype(np.float32)


def _write(path: str | Path, array: np.ndarray, pixel_type: oiio.BASETYPE) -> None:
    path = Path(path)
    try:
        name = utf8_name(path)
    except UserError as error:
        raise OSError(f"{path}: cannot be written: expected {error.expected}") from error
    pixels = np.ascontiguousarray(array if array.ndim == 3 else array[..., None])
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, pixel_type)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("DateTime", "")  # an EXR would hold the hour: the same pixels make the same file
    output = oiio.ImageOutput.create(name)
    if output is None:
        raise OSError(f"{path}: cannot be written: {oiio.geterror()}")
    written = output.open(name, spec) and output.write_image(pixels)
    fault = output.geterror()
    if not output.close() or not written:
        raise OSError(f"{path}: cannot be written: {fault or output.geterror() or oiio.geterror()}")
    _check_written(path)


def _check_written(path: Path) -> None:
    """Read a file back: OpenImageIO does not look at how many of its last bytes the disk took.

    Of a PNG the chunks' checksums tell, in a hundredth of the time that it takes to write one.
    """
    try:
        if not check_whole(path, pixels=True):
            with opened(path, whole=True) as image:
                decode(image, path, oiio.FLOAT)
    except UserError as fault:
        raise OSError(f"{path}: cannot be written whole: found {fault.found}") from fault
