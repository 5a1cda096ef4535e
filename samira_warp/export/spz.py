"""A .spz of Niantic: compressed splats, 19 or 20 bytes each before a general compression.

A header, then each attribute of all splats in a row (the format's description is that of its library,
https://github.com/nianticlabs/spz, README.md). Versions differ in how rotations are packed, and in what packs
the file:

    2   x, y, z of the quaternion, 8 bits each, where w is not negative; one gzip stream
    3   the index of the largest component, the others in 10 bits each; one gzip stream
    4   as 3; a zstd stream for each attribute, after a table of their lengths

No library that pip installs writes version 2, the only one that every reader opened that was tried
(docs/exports.md).
"""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path

import numpy as np
from torch import Tensor

from samira_warp.export.config import SPZ_VERSION
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats
from samira_warp.support.errors import UserError

MAGIC = 0x5053474E
"""The letters NGSP."""

ANTIALIASED = 1
"""The flag that says: whoever widens a splat for the pixels takes from its opacity what that adds."""

POSITION_BITS = 24
"""Of a coordinate, its sign among them."""

FARTHEST = 1000.0
"""Metres: with 12 bits after the point, as most files have."""

COLOR_SCALE = 0.15
"""Bytes span coefficients from -1 / (2 COLOR_SCALE) to the opposite: colours from -0.44 to 1.44."""

ZSTD_LEVEL = 12
"""As the format's library has it."""


def write(source: ExportSource, path: Path) -> str:
    """Write the chosen frame in the version that is asked for."""
    (frame,) = source.chosen
    splats, version = frame_splats(source, frame), source.config.spz_version or SPZ_VERSION
    path.write_bytes(encode(splats, version=version))
    return f"{len(splats.means):,} splats of frame {frame.name}, version {version}"


def encode(splats: Splats, *, version: int) -> bytes:
    """The bytes of a file.

    Raises:
        UserError: A splat is farther from the origin than the format can say.
    """
    bits = _fractional_bits(splats.means)
    rotations = _first_three if version == 2 else _smallest_three
    sections = [
        _positions(splats.means, bits),
        # at 0 and 255 some readers have infinite logits: invisible splats, or none at all
        _bytes(255.0 * _array(splats.opacities), low=1, high=254),
        _bytes(255.0 * (COLOR_SCALE * _array(splats.harmonics) + 0.5)),
        _bytes(16.0 * (np.log(_array(splats.scales)) + 10.0)),
        rotations(_array(splats.quaternions)),
    ]
    start = struct.pack("<IIIBBB", MAGIC, version, len(splats.means), 0, bits, ANTIALIASED)
    packed = _gzip if version < 4 else _zstd
    return packed(start, sections)


def _fractional_bits(means: Tensor) -> int:
    """Bits after the point of a coordinate: as many as the farthest splat leaves.

    The 12 that are usual are steps of a quarter of a millimetre, in metres.
    """
    farthest = float(means.abs().max()) if len(means) else 0.0
    if not farthest < FARTHEST:  # not a number is not, either
        raise UserError("a splat", expected=f"less than {FARTHEST:g} m from the origin", found=farthest)
    whole = 0 if farthest < 1.0 else math.floor(math.log2(farthest)) + 1
    return POSITION_BITS - 2 - whole  # one is the sign's, one is spared for rounding


def _positions(means: Tensor, bits: int) -> bytes:
    """Each coordinate as three bytes, the lowest first."""
    steps = np.rint(_array(means) * 2.0**bits).astype("<i4")
    return steps.view(np.uint8).reshape(-1, 3, 4)[..., :3].tobytes()


def _first_three(quaternions: np.ndarray) -> bytes:
    """x, y and z of (N, 4) unit quaternions w, x, y, z, for which w >= 0 follows.

    It follows badly where it is small: 7 degrees off at 8 bits. But an ellipsoid is the same after half a
    turn about an axis of its own, and of the quaternions q, q i, q j and q k that it has, one has w >= 1/2.
    """
    w, x, y, z = quaternions.T
    alike = np.stack([(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)]).transpose(2, 0, 1)
    best = alike[np.arange(len(alike)), np.abs(alike[..., 0]).argmax(axis=1)]
    imaginary = np.where(best[:, :1] < 0.0, -1.0, 1.0) * best[:, 1:]
    return _bytes(127.5 * (imaginary + 1.0))


def _smallest_three(quaternions: np.ndarray) -> bytes:
    """All but the largest component of (N, 4) unit quaternions w, x, y, z: a sign, 9 bits of its size."""
    components = np.roll(quaternions, -1, axis=1)
    largest = np.abs(components).argmax(axis=1)
    components = components * np.where(components[np.arange(len(largest)), largest] < 0.0, -1.0, 1.0)[:, None]
    sizes = np.rint(511.0 * math.sqrt(2.0) * np.abs(components)).clip(0, 511).astype(np.uint32)
    words = (np.uint32(512) * (components < 0.0) + sizes).astype(np.uint32)
    packed = np.zeros(len(largest), np.uint32)
    for component in range(4):
        packed = np.where(component == largest, packed, packed << np.uint32(10) | words[:, component])
    return (largest.astype(np.uint32) << np.uint32(30) | packed).astype("<u4").tobytes()


def _gzip(start: bytes, sections: list[bytes]) -> bytes:
    """One stream of all, with no time in it: the same splats are the same bytes."""
    return gzip.compress(b"".join([start, b"\0", *sections]), mtime=0)


def _zstd(start: bytes, sections: list[bytes]) -> bytes:
    """A header of 32 bytes, for each section its length before and after, and the sections."""
    import zstandard

    compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
    streams = [compressor.compress(section) for section in sections]
    header = start + struct.pack("<BI12x", len(sections), 32)
    lengths = [
        struct.pack("<QQ", len(stream), len(section))
        for stream, section in zip(streams, sections, strict=True)
    ]
    return b"".join([header, *lengths, *streams])


def _bytes(values: np.ndarray, *, low: int = 0, high: int = 255) -> bytes:
    return np.rint(values).clip(low, high).astype(np.uint8).tobytes()


def _array(values: Tensor) -> np.ndarray:
    """In float64: what is rounded here is rounded once."""
    return values.detach().cpu().double().numpy()
