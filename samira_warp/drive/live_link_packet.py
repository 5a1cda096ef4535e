"""Datagrams of Epic's Live Link Face, as the app sends them to port 11111.

A byte of the layout's version; the device's id and the subject's name, each a big-endian 32-bit length and so
many bytes; the frame's number, part of a frame, and the rate's numerator and denominator, 32 bits each; a
byte that counts the values, and these, big-endian 32-bit floats: the shapes and the angles in Unreal's order.
Where no face is seen a datagram ends before the count. Documented by Unreal's AppleARKitLiveLinkSource.cpp,
and after it by https://github.com/tbxMb/GodotLiveLinkFace (doc/proto.md) and
https://github.com/think-biq/LLV.
"""

from __future__ import annotations

import math
import struct

from samira_warp.drive.arkit import SHAPES, FaceSignal
from samira_warp.drive.live_link_csv import ANGLES, signal_of

VERSION = 6
"""Of the layout that is read."""

LONGEST = 256
"""Bytes that an id or a name may have."""

_TIME = struct.Struct(">ifii")
_NAMES = (*SHAPES, *ANGLES)


def is_live_link(packet: bytes) -> bool:
    """Whether a datagram begins as the app's do."""
    return packet[:1] == bytes([VERSION])


def read_live_link(packet: bytes, seconds: float) -> FaceSignal | None:
    """The frame of a datagram that came at a time; None where it shows no face.

    Raises:
        ValueError: It is not of that layout; the message says where.
    """
    at = 1
    for what in ("id", "name"):
        if len(packet) < at + 4:
            raise ValueError(f"it ends before the {what}'s length")
        (length,) = struct.unpack_from(">I", packet, at)
        if length > LONGEST:
            raise ValueError(f"its {what} has {length} bytes")
        at += 4 + length
    if len(packet) < at + _TIME.size:
        raise ValueError("it ends before the time")
    at += _TIME.size
    if len(packet) == at:
        return None
    count = packet[at]
    if count != len(_NAMES):
        raise ValueError(f"it has {count} values and not {len(_NAMES)}")
    if len(packet) < at + 1 + 4 * count:
        raise ValueError(f"it ends before its {count} values do")
    values = struct.unpack_from(f">{count}f", packet, at + 1)
    if not all(map(math.isfinite, values)):
        raise ValueError("a value is no number")
    return signal_of(dict(zip(_NAMES, values, strict=True)), seconds)
