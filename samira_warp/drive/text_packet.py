"""Datagrams of iFacialMocap and Facemotion3d: text, a shape or an angle between bars.

    mouthSmile_R-0|eyeBlink_L-7|...|=head#-21.5,-6.0,-6.6,-0.03,-0.1,-0.66|rightEye#6.0,2.4,0.3|leftEye#6.0,-1.7,-0.2|

Shapes go from 0 to 100; turns are Euler angles about x, y and z in degrees, of which x nods down, y turns to
the left and z tilts to the right: in the pages' frames eyes that look down by the shapes have a positive x,
and a right eye that looks in has a positive y. A head's place follows its turn, and is not used. Version 2
has & in place of the hyphen. https://www.ifacialmocap.com/for-developer/ and https://www.facemotion3d.net say
so.
"""

from __future__ import annotations

import math

import numpy as np

from samira_warp.drive.arkit import NUMBER_OF, SHAPES, FaceSignal, known_shape, turn_of

PERCENT = 100.0


def is_text(packet: bytes) -> bool:
    """Whether a datagram may be one of these apps'."""
    return b"|" in packet and (b"#" in packet or b"&" in packet or b"-" in packet) and packet[:1].isalpha()


def read_text(packet: bytes, seconds: float) -> FaceSignal:
    """The frame of a datagram that came at a time.

    Raises:
        ValueError: It is not of that layout; the message says where.
    """
    shapes, known = np.zeros(len(SHAPES)), 0
    turns: dict[str, np.ndarray] = {}
    for part in packet.decode("utf-8").split("|"):
        part = part.strip()
        if "#" in part:
            name, _, text = part.partition("#")
            turns[name.lstrip("=")] = _turn(part, text)
        elif part:
            name, value = _shape(part)
            number = NUMBER_OF.get(known_shape(name) or "")
            if number is not None:
                shapes[number], known = value, known + 1
    if not known:
        raise ValueError("none of ARKit's shapes is in it")
    eyes = None
    if "leftEye" in turns and "rightEye" in turns:
        eyes = np.stack([turns["leftEye"], turns["rightEye"]])
    return FaceSignal(seconds, shapes, turns.get("head"), eyes)


def _shape(part: str) -> tuple[str, float]:
    """A name and its value, 0 to 1; the name ends at & or at the last hyphen."""
    name, mark, text = part.partition("&") if "&" in part else part.rpartition("-")
    value = _number(part, text)
    if not mark or not name:
        raise ValueError(f"{part!r} is no shape")
    return name, value / PERCENT


def _turn(part: str, text: str) -> np.ndarray:
    values = [_number(part, value) for value in text.split(",")]
    if len(values) < 3:
        raise ValueError(f"{part!r} has {len(values)} angles")
    return turn_of(*np.radians(values[:3]))


def _number(part: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{part!r} has no number")
    return value
