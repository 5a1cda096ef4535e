"""From a decoded frame of a video to the picture that is shown.

A frame says how it is meant: in which colours, with pixels of which shape, and which way up. Players follow
that; decoders hand it on. Display values here are sRGB's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple, cast

import av
import numpy as np
import torch
from av.sidedata.sidedata import SideData
from av.video.reformatter import Colorspace

from samira_warp.io.images import resize_box
from samira_warp.light import decode_srgb, encode_srgb
from samira_warp.light.primaries import NAMED, to_rec709
from samira_warp.support.errors import UserError

UNSPECIFIED, BT2020 = 2, 9
"""Of the matrices and primaries that ITU-T H.273 numbers, those that are told apart here."""

UNREADABLE_MATRICES = {
    8: "YCgCo",
    10: "BT.2020 with constant luminance",
    14: "ICtCp",
    15: "IPT-PQ (Dolby Vision)",
}
"""H.273's matrices that FFmpeg's scaler would take for another."""

PQ, HLG = 16, 18
"""H.273's transfer characteristics of pictures of high dynamic range."""

HD_WIDTH, SD_HEIGHT = 1280, 576
"""Pixels: pictures without a tag are BT.709 when they are at least so wide or higher than that, as players
have it; FFmpeg's scaler takes every one for BT.601."""

REFERENCE_WHITE = 203.0
"""cd/m^2 of diffuse white in a picture of high dynamic range (ITU-R BT.2408)."""

HLG_WHITE = 0.265
"""Scene light of HLG's signal of 75 %, where BT.2408 puts diffuse white; full scale is 1."""

SHOULDER = 0.8
"""Linear light, white being 1: up to here nothing is compressed, above it 1 is approached."""

PIXEL_ASPECTS = (0.25, 4.0)
"""Pixels of another shape are nobody's; such a tag is a fault of the file."""

SAME_SHAPE = 0.02
"""Aspects that differ by less are one shape: codecs want even numbers of pixels, so small pictures round."""

_CHROMATICITIES = {
    BT2020: NAMED["lin_rec2020_scene"],
    11: NAMED["lin_p3d65_scene"],
    12: NAMED["lin_p3d65_scene"],
}
"""Wide primaries by H.273's number. White is D65, also of DCI-P3's (11), whose films for screens come with
it; SD's primaries are as good as BT.709's."""


class Turn(NamedTuple):
    """Which way up: the picture as stored is transposed, then mirrored.

    Attributes:
        transposed: Rows become columns.
        mirrored_x: Left and right change places, after that.
        mirrored_y: Top and bottom change places, after that.
    """

    transposed: bool = False
    mirrored_x: bool = False
    mirrored_y: bool = False

    def of(self, picture: np.ndarray) -> np.ndarray:
        """A picture (H, W, C), put upright; a view."""
        if self.transposed:
            picture = picture.swapaxes(0, 1)
        return picture[:: -1 if self.mirrored_y else 1, :: -1 if self.mirrored_x else 1]


@dataclass(frozen=True)
class Appearance:
    """How the frames of one stream are shown.

    Attributes:
        path: The file, for what is said about it.
        pixel_aspect: Width of a stored pixel over its height.
        size: (width, height) of every picture as it is shown, pixels; None is each frame's own.
    """

    path: Path
    pixel_aspect: float = 1.0
    size: tuple[int, int] | None = None

    @classmethod
    def of(cls, path: Path, stream: av.VideoStream) -> Appearance:
        """How a stream's header says that its frames are shown.

        Raises:
            UserError: Its pixels have a shape that nobody's have.
        """
        aspect = float(stream.sample_aspect_ratio or 1.0) or 1.0
        low, high = PIXEL_ASPECTS
        if not low <= aspect <= high:
            expected = f"pixels {low:g} to {high:g} times as wide as high"
            raise UserError(path, expected=expected, found=f"{aspect:g}")
        return cls(path, aspect)

    def shown_size(self, frame: av.VideoFrame) -> tuple[int, int]:
        """(width, height) of a frame with square pixels, upright: the longer side of a pixel counts."""
        width, height = self._square(frame.width, frame.height)
        return (height, width) if turn_of(frame).transposed else (width, height)

    def pixels(self, frame: av.VideoFrame) -> np.ndarray:
        """(H, W, 3) uint8 display values of a frame as it is shown.

        Raises:
            UserError: Its colours cannot be read, or its shape is not that of the frames before it.
        """
        turn, picture = turn_of(frame), _display_values(frame, self.path)
        picture = turn.of(picture)
        width, height = self.size or self.shown_size(frame)
        if picture.shape[:2] != (height, width):
            self._check_shape(frame, width=width, height=height)
            resized = resize_box(picture.astype(np.float32), width=width, height=height)
            picture = np.rint(resized).astype(np.uint8)
        return np.ascontiguousarray(picture)

    def _square(self, width: int, height: int) -> tuple[int, int]:
        if self.pixel_aspect >= 1.0:
            return round(width * self.pixel_aspect), height
        return width, round(height / self.pixel_aspect)

    def _check_shape(self, frame: av.VideoFrame, *, width: int, height: int) -> None:
        """Frames may change their size within a film (calls over a network do), not their shape."""
        now = self.shown_size(frame)
        aspect, before = now[0] / now[1], width / height
        if not 1.0 - SAME_SHAPE < aspect / before < 1.0 + SAME_SHAPE:
            at = "" if frame.time is None else f" after {frame.time:.1f} s"
            raise UserError(
                self.path,
                expected=f"pictures of one shape, {width} x {height} as the first (cut the film there)",
                found=f"{now[0]} x {now[1]}{at}",
            )


def turn_of(frame: av.VideoFrame) -> Turn:
    """The turn that a frame's display matrix asks for, of the eight by right angles the nearest.

    The matrix takes a stored place (x, y) to (a x + c y, b x + d y); phones write turns, their front cameras
    and editors mirror as well.
    """
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return Turn()
    a, b, _, c, d = np.frombuffer(memoryview(cast(SideData, matrix)), np.int32)[:5].tolist()
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return Turn(False, a < 0, d < 0)
    return Turn(True, c < 0, b < 0)


def dynamic_range(frame: av.VideoFrame) -> str | None:
    """Which of the two a frame of high dynamic range is, HLG or PQ; None of any other."""
    return {HLG: "HLG", PQ: "PQ"}.get(int(frame.color_trc or 0))


def _display_values(frame: av.VideoFrame, path: Path) -> np.ndarray:
    """(H, W, 3) uint8 sRGB display values of a frame as it is stored."""
    matrix = int(frame.colorspace if frame.colorspace is not None else UNSPECIFIED)
    if matrix in UNREADABLE_MATRICES:
        expected = "colours by BT.601, BT.709 or BT.2020"
        raise UserError(path, expected=expected, found=UNREADABLE_MATRICES[matrix])
    source = _matrix(frame, matrix)
    transfer, primaries = int(frame.color_trc or 0), int(frame.color_primaries or UNSPECIFIED)
    if transfer not in (PQ, HLG) and primaries not in _CHROMATICITIES:
        return frame.to_ndarray(format="rgb24", src_colorspace=source)
    wide = primaries if primaries in _CHROMATICITIES else BT2020
    linear = _linear_light(transfer)[frame.to_ndarray(format="rgb48le", src_colorspace=source)]
    linear = linear @ _to_bt709(wide).T.astype(np.float32)
    return _encoded()[np.rint(_shoulder(linear) * (len(_encoded()) - 1)).astype(np.int32)]


def _matrix(frame: av.VideoFrame, tagged: int) -> Colorspace | None:
    """The matrix to read a frame by where its tag does not say it, else None."""
    if tagged != UNSPECIFIED or frame.format.is_rgb:
        return None
    if int(frame.color_primaries or UNSPECIFIED) == BT2020:
        return Colorspace.BT2020
    return Colorspace.ITU709 if frame.width >= HD_WIDTH or frame.height > SD_HEIGHT else None


@cache
def _linear_light(transfer: int) -> np.ndarray:
    """(65536,) float32 light, diffuse white being 1, of every 16-bit signal.

    HLG is read as what it is, the scene's light: the system's gamma, which suits a dark room and a bright
    screen, would take the light of a face out of proportion.
    """
    signal = np.arange(65536) / 65535.0
    if transfer == HLG:  # ITU-R BT.2100, inverse of the opto-electronic transfer
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(signal <= 0.5, signal**2 / 3.0, (np.exp((signal - c) / a) + b) / 12.0) / HLG_WHITE
    elif transfer == PQ:  # SMPTE ST 2084
        m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
        power = signal ** (1.0 / m2)
        light = 10_000.0 / REFERENCE_WHITE * (np.maximum(power - c1, 0.0) / (c2 - c3 * power)) ** (1.0 / m1)
    else:
        light = decode_srgb(torch.from_numpy(signal)).numpy()
    return light.astype(np.float32)


@cache
def _encoded() -> np.ndarray:
    """(65536,) uint8 sRGB display values of linear light from 0 to 1."""
    light = torch.arange(65536, dtype=torch.float64) / 65535.0
    return np.rint(255.0 * encode_srgb(light).numpy()).astype(np.uint8)


def _shoulder(linear: np.ndarray) -> np.ndarray:
    """Light of 0 and more in 0 to 1: as it is up to SHOULDER, with its slope beyond, never quite 1."""
    room = 1.0 - SHOULDER
    above = np.maximum(linear - SHOULDER, 0.0)
    return np.clip(np.where(linear > SHOULDER, SHOULDER + room * above / (room + above), linear), 0.0, 1.0)


@cache
def _to_bt709(primaries: int) -> np.ndarray:
    """(3, 3) linear light of wide primaries to that of BT.709's."""
    matrix = to_rec709(_CHROMATICITIES[primaries])
    return np.eye(3) if matrix is None else matrix
