"""Whether a picture file is whole, told by its own format before it is decoded.

Decoders fill in what is missing: grey below a cut JPEG, blurs for the scans of a progressive one, zeros for
what a full disk or a broken copy never wrote. What is looked at here:

    PNG    the length and checksum of every chunk, up to IEND
    JPEG   the markers, up to the end of the image, and that its scans give every coefficient its last bit
    WebP   the chunks, and that the picture's own do not run out in zeros
    TIFF   that every strip or tile was written and lies within the file

OpenImageIO tells by itself of cut files in the other formats (OpenEXR's table of chunks, the rows of a
Radiance file, a BMP's size), and `samira_warp.io.decoding` refuses a picture with which any complaint came.
What follows a picture's end is no fault: cameras append a second picture, editors their notes. Nor can a
wrong value be told from a right one where a format has no checksums.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np

from samira_warp.support.errors import UserError

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_TIFF = {b"II*\0": "<", b"MM\0*": ">", b"II+\0": "<", b"MM\0+": ">"}

_ZEROS = bytes(64)
"""More zeros than a compressed picture ends in."""

_IS_MARKER = np.ones(256, bool)
_IS_MARKER[[0x00, 0x01, *range(0xD0, 0xD8), 0xFF]] = False
"""By the byte that follows a 0xff: whether the two are a JPEG's marker, and no part of its coded data."""

_START, _END, _SCAN = 0xD8, 0xD9, 0xDA
_SEQUENTIAL, _PROGRESSIVE = (0xC0, 0xC1, 0xC9), (0xC2, 0xCA)
"""A JPEG's markers: start and end of the image, start of a scan, and of a frame of the two kinds."""

_COEFFICIENTS = 64

_OFFSETS = {273: "strip", 324: "tile"}
_COUNTS = {279, 325}
_INTEGERS = {3: "u2", 4: "u4", 16: "u8"}
"""TIFF's tags for where strips and tiles lie and how long they are, and its types of whole numbers."""


def check_whole(path: Path, *, pixels: bool) -> bool:
    """Raise UserError where a file is known to be cut short.

    Args:
        path: A file of any kind.
        pixels: Whether its pixels are wanted; else its header alone has to be there.

    Returns:
        Whether it is of a format that can be told here; of others decoding tells.

    Raises:
        UserError: It is not whole.
    """
    with path.open("rb") as file:
        head = file.read(12)
        file.seek(0)
        if head.startswith(_PNG):
            _check_png(path, file, pixels=pixels)
        elif not pixels:
            return False
        elif head.startswith(_JPEG):
            _check_jpeg(path, file.read())
        elif head[:4] == b"RIFF" and head[8:] == b"WEBP":
            _check_webp(path, file.read())
        elif head[:4] in _TIFF:
            _check_tiff(path, file, head)
        else:
            return False
    return True


def _refuse(path: Path, kind: str, found: str) -> NoReturn:
    raise UserError(path, expected=f"a whole {kind} image", found=found)


def _check_png(path: Path, file: BinaryIO, *, pixels: bool) -> None:
    """Walk a PNG's chunks before libpng does: it would print its own lines about a broken file."""
    file.seek(len(_PNG))
    name, has_pixels = b"", False
    while name != b"IEND":
        name = _check_chunk(path, file)
        has_pixels |= name == b"IDAT"
        if has_pixels and not pixels:
            return
    if not has_pixels:
        _refuse(path, "PNG", "no pixels")


def _check_chunk(path: Path, file: BinaryIO) -> bytes:
    head = file.read(8)
    if len(head) < 8:
        _refuse(path, "PNG", f"the file's end after {file.tell()} bytes")
    length, name = struct.unpack(">I4s", head)
    body = file.read(length + 4)
    if len(body) < length + 4:
        _refuse(path, "PNG", f"the file's end within its {name.decode('latin-1')!r} chunk")
    if zlib.crc32(body[:-4], zlib.crc32(name)) != int.from_bytes(body[-4:], "big"):
        _refuse(path, "PNG", f"a wrong checksum in its {name.decode('latin-1')!r} chunk")
    return name


def _check_jpeg(path: Path, data: bytes) -> None:
    """Walk a JPEG's segments up to the end of its image: thumbnails are inside segments, and skipped."""
    values = np.frombuffer(data, np.uint8)
    markers = np.flatnonzero(values[:-1] == 0xFF)
    markers = markers[_IS_MARKER[values[markers + 1]]]
    known: dict[int, np.ndarray] = {}
    progressive = False
    position = 2
    while (next_one := int(np.searchsorted(markers, position))) < len(markers):
        start = int(markers[next_one]) + 2
        marker = data[start - 1]
        if marker == _END:
            missing = [component for component, bits in known.items() if (bits != 0).any()]
            if missing:
                _refuse(path, "JPEG", f"scans missing for {len(missing)} of its {len(known)} components")
            return
        if marker == _START:
            _refuse(path, "JPEG", f"another picture's start after {start} bytes, before its own end")
        length = int.from_bytes(data[start : start + 2], "big")
        segment, position = data[start + 2 : start + length], start + length
        if marker in _SEQUENTIAL + _PROGRESSIVE:
            progressive = marker in _PROGRESSIVE
            known = {component: np.full(_COEFFICIENTS, -1) for component in segment[6::3]}
        elif marker == _SCAN and segment:
            _note_scan(known, segment, progressive=progressive)
    _refuse(path, "JPEG", f"the file's end after {len(data)} bytes, before the image's")


def _note_scan(known: dict[int, np.ndarray], scan: bytes, *, progressive: bool) -> None:
    """Note which coefficients a scan gives, and how many of their low bits it leaves out.

    Args:
        known: Bits that are left out of each component's coefficients so far, -1 where nothing is known.
        scan: The scan's header: its components, then the range of coefficients and the bits.
        progressive: Whether the range counts; else a scan gives all.
    """
    count = scan[0]
    first, last, bits = scan[1 + 2 * count : 4 + 2 * count] if progressive else (0, _COEFFICIENTS - 1, 0)
    for component in scan[1 : 1 + 2 * count : 2]:
        if component in known:
            known[component][first : last + 1] = bits & 15


def _check_webp(path: Path, data: bytes) -> None:
    size = 8 + int.from_bytes(data[4:8], "little")
    if len(data) < size:
        _refuse(path, "WebP", f"{len(data)} of {size} bytes")
    position = 12
    while position + 8 <= size:
        name, length = (
            data[position : position + 4],
            int.from_bytes(data[position + 4 : position + 8], "little"),
        )
        body = data[position + 8 : position + 8 + length]
        if name in (b"VP8 ", b"VP8L") and body.endswith(_ZEROS):
            _refuse(path, "WebP", f"zeros at the end of its {name.decode().strip()} chunk")
        position += 8 + length + length % 2


def _check_tiff(path: Path, file: BinaryIO, head: bytes) -> None:
    """Look up where the first picture's strips or tiles lie; those that were never written lie at zero."""
    order, big = _TIFF[head[:4]], head[2:4].strip(b"\0") == b"+"
    size = file.seek(0, 2)
    file.seek(8 if big else 4)
    file.seek(_whole_number(file, order, 8 if big else 4))
    entries = _whole_number(file, order, 8 if big else 2)
    layout = struct.Struct(f"{order}HHQ8s" if big else f"{order}HHI4s")
    directory = file.read(min(entries * layout.size, size))
    if len(directory) < entries * layout.size:
        _refuse(path, "TIFF", f"the file's end within its directory, after {size} bytes")
    offsets, counts, kind = np.zeros(0, np.uint64), np.zeros(0, np.uint64), "strip"
    for entry in layout.iter_unpack(directory):
        if entry[0] in _OFFSETS:
            offsets, kind = _whole_numbers(file, order, entry), _OFFSETS[entry[0]]
        elif entry[0] in _COUNTS:
            counts = _whole_numbers(file, order, entry)
    if (offsets == 0).any():
        _refuse(path, "TIFF", f"{int((offsets == 0).sum())} of {len(offsets)} {kind}s never written")
    if len(offsets) == len(counts) and (offsets + counts > size).any():
        cut = int((offsets + counts > size).sum())
        _refuse(path, "TIFF", f"{cut} of {len(offsets)} {kind}s beyond the file's end")


def _whole_number(file: BinaryIO, order: str, size: int) -> int:
    return int.from_bytes(file.read(size), "little" if order == "<" else "big")


def _whole_numbers(file: BinaryIO, order: str, entry: tuple[int, int, int, bytes]) -> np.ndarray:
    """(N,) uint64 of a directory's entry (tag, type, N, the numbers or where they are)."""
    _, kind, count, place = entry
    if kind not in _INTEGERS:
        return np.zeros(0, np.uint64)
    numbers = np.dtype(f"{order}{_INTEGERS[kind]}")
    if count * numbers.itemsize > len(place):
        file.seek(int.from_bytes(place, "little" if order == "<" else "big"))
        place = file.read(count * numbers.itemsize)
    whole = len(place) // numbers.itemsize
    return np.frombuffer(place, numbers, count=min(count, whole)).astype(np.uint64)
