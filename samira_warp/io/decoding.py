"""Image files opened and decoded by OpenImageIO: whole, or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses

from samira_warp.io.orientation import LYING, upright
from samira_warp.io.radiance_header import read_orientation
from samira_warp.io.whole import check_whole
from samira_warp.support.errors import UserError

_HARMLESS = (
    "Invalid SOS parameters for sequential JPEG",
    "extraneous bytes before marker",
    "Unknown Adobe color transform code",
    "unknown JFIF revision number",
)
"""What libjpeg says of files whose pixels are all there."""

_WINDOWED = ("openexr", "tiff")
"""Formats that may store a part of the picture, or more than it, and say which."""

_BLOCK_VALUES = 1 << 23
"""How many numbers are decoded at once of a large picture: 32 MB."""


class Span(NamedTuple):
    """Rows or columns of a picture that its file stores: which they are of the stored, and of the picture."""

    stored: slice
    picture: slice


class Layout(NamedTuple):
    """Which pixels of the picture are stored, in the orientation in which they are.

    Attributes:
        width: Of the whole picture, pixels.
        height: Of the whole picture, pixels.
        rows: The rows that are stored.
        columns: The columns that are stored.
    """

    width: int
    height: int
    rows: Span
    columns: Span


@contextmanager
def opened(path: Path, *, whole: bool) -> Iterator[oiio.ImageInput]:
    """An image file whose pixels (``whole``) or header alone will be read; alpha is not multiplied in.

    Raises:
        UserError: The file is missing, is no image, or is cut short.
    """
    if not path.is_file():
        raise UserError(path, expected="an image file", found="a folder" if path.is_dir() else "no such file")
    try:
        check_whole(path, pixels=whole)
    except OSError as error:
        raise UserError(path, expected="a readable image", found=error.strerror) from error
    straight = oiio.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio.ImageInput.open(utf8_name(path), straight)
    if image is None:
        raise UserError(path, expected="a readable image", found=oiio.geterror() or "an unknown format")
    try:
        yield image
    finally:
        image.close()
        oiio.geterror()  # a codec reports twice; what is left here would be blamed on the next file


def utf8_name(path: Path) -> str:
    """A file's name as OpenImageIO takes it: in UTF-8, whatever the locale is.

    Raises:
        UserError: The name is none in UTF-8, or has characters that the locale does not know.
    """
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeError as error:
        raise UserError(path, expected="a file's name in UTF-8", found=error) from error


def orientation_of(image: oiio.ImageInput, path: Path, *, part: int = 0) -> int:
    """EXIF's number, from 1 to 8, of how a part's pixels are stored (`samira_warp.io.orientation`)."""
    if image.format_name() == "hdr":  # of whose orders OpenImageIO takes two for each other
        return read_orientation(path)
    number = image.spec(part).get_int_attribute("Orientation", 1)
    return number if 1 <= number <= 8 else 1


def picture_size(image: oiio.ImageInput, path: Path) -> tuple[int, int]:
    """(width, height) in pixels of the picture as it is shown, upright.

    Raises:
        UserError: The file stores none of its pixels.
    """
    layout = layout_of(image, path)
    size = layout.width, layout.height
    return size[::-1] if orientation_of(image, path) in LYING else size


def layout_of(image: oiio.ImageInput, path: Path, *, part: int = 0) -> Layout:
    """Where a part's pixels lie in its picture, which is an EXR's display window.

    Raises:
        UserError: None of them lies in it.
    """
    spec = image.spec(part)
    if image.format_name() not in _WINDOWED:
        whole_rows, whole_columns = slice(0, spec.height), slice(0, spec.width)
        return Layout(
            spec.width, spec.height, Span(whole_rows, whole_rows), Span(whole_columns, whole_columns)
        )
    rows = _span(spec.y - spec.full_y, spec.height, spec.full_height)
    columns = _span(spec.x - spec.full_x, spec.width, spec.full_width)
    if min(span.picture.stop - span.picture.start for span in (rows, columns)) <= 0:
        raise UserError(path, expected="pixels within the picture (display window)", found="none there")
    return Layout(spec.full_width, spec.full_height, rows, columns)


def _span(start: int, stored: int, whole: int) -> Span:
    """Of ``stored`` rows or columns from ``start`` on, those that a picture of ``whole`` has."""
    first, end = max(start, 0), min(start + stored, whole)
    return Span(slice(first - start, end - start), slice(first, end))


def decode(image: oiio.ImageInput, path: Path, pixel_type: oiio.BASETYPE) -> np.ndarray:
    """(H, W, C) pixels of an open image as it is shown, upright; 0 where its file stores none.

    Raises:
        UserError: They cannot be decoded, or not all of them.
    """
    layout, orientation = layout_of(image, path), orientation_of(image, path)
    pixels = _complete(image.read_image(pixel_type), image, path)
    if pixels.shape[:2] != (layout.height, layout.width):
        picture = np.zeros((layout.height, layout.width, pixels.shape[2]), pixels.dtype)
        stored = pixels[layout.rows.stored, layout.columns.stored]
        picture[layout.rows.picture, layout.columns.picture] = stored
        pixels = picture
    return np.ascontiguousarray(upright(pixels, orientation))


def decode_blocks(
    image: oiio.ImageInput, path: Path, *, part: int, channels: range
) -> Iterator[tuple[int, np.ndarray]]:
    """Blocks of rows of one part of an open image, which need little memory.

    Args:
        image: The open image.
        path: Its file, for messages.
        part: Which of its parts.
        channels: Which of its channels, C of them.

    Yields:
        The number of the block's first row among those stored, and (h, w, C) float32 pixels.

    Raises:
        UserError: They cannot be decoded, or not all of them.
    """
    spec = image.spec(part)
    step = max(_BLOCK_VALUES // max(spec.width * len(channels), 1), 1)
    if spec.tile_width:
        step = max(step // spec.tile_height, 1) * spec.tile_height
    for first in range(0, spec.height, step):
        top, bottom = spec.y + first, spec.y + min(first + step, spec.height)
        ends = (channels.start, channels.stop, oiio.FLOAT)
        if spec.tile_width:
            block = image.read_tiles(part, 0, spec.x, spec.x + spec.width, top, bottom, 0, 1, *ends)
        else:
            block = image.read_scanlines(part, 0, top, bottom, 0, *ends)
        yield first, _complete(block, image, path)


def _complete(pixels: np.ndarray | None, image: oiio.ImageInput, path: Path) -> np.ndarray:
    """The pixels, unless anything was said against them: decoders go on where data are missing."""
    fault = image.geterror()
    harmless = all(any(words in line for words in _HARMLESS) for line in fault.splitlines())
    if pixels is None or not harmless:
        raise UserError(path, expected="a readable image", found=fault or "broken pixel data")
    return pixels
