"""Datagrams of Open Sound Control: Face Cap's addresses, and those of the Virtual Motion Capture protocol.

Face Cap (https://shifty-bits.com/face-cap/livemode.html): /W with a shape's number and its value, /HR with
the head's turn about x, y and z in degrees, /ELR and /ERR with the left and the right eye's about x and y.
The page does not say whose axes these are; they are taken for ARKit's own, as `FaceSignal` has them.

VMC (https://protocol.vmc.info/english): /VMC/Ext/Blend/Val with a name and a value, which count from
/VMC/Ext/Blend/Apply on; /VMC/Ext/Bone/Pos with a name, a place and a quaternion (x, y, z, w) in Unity's
left-handed axes, of which Neck, Head, LeftEye and RightEye are read. Performers that send ARKit's 52 names
("perfect sync") move a face; the five vowels of VRM do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from samira_warp.drive.arkit import NUMBER_OF, SHAPES, FaceSignal, known_shape, turn_of
from samira_warp.support.errors import UserError

_SIDES = ("Left", "Right")

FACE_CAP_ORDER = (
    *("browInnerUp", "browDownLeft", "browDownRight", "browOuterUpLeft", "browOuterUpRight"),
    *(f"eyeLook{way}{side}" for way in ("Up", "Down", "In", "Out") for side in _SIDES),
    *(f"eye{what}{side}" for what in ("Blink", "Squint", "Wide") for side in _SIDES),
    *("cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight"),
    *("jawOpen", "jawForward", "jawLeft", "jawRight"),
    *("mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *("mouthRollUpper", "mouthRollLower", "mouthShrugUpper", "mouthShrugLower", "mouthClose"),
    *(f"mouth{what}{side}" for what in ("Smile", "Frown", "Dimple", "UpperUp") for side in _SIDES),
    *(f"mouth{what}{side}" for what in ("LowerDown", "Press", "Stretch") for side in _SIDES),
    "tongueOut",
)
"""Shapes by the numbers of /W."""


def is_osc(packet: bytes) -> bool:
    """Whether a datagram is Open Sound Control: a bundle, or a message, whose address begins with a slash."""
    return packet.startswith((b"/", b"#bundle"))


class OscFace:
    """What messages have said of a face so far; each of them says a part."""

    def __init__(self) -> None:
        """Nothing said yet.

        Raises:
            UserError: python-osc, which takes datagrams apart, is not there.
        """
        try:
            from pythonosc.osc_packet import OscPacket, ParseError
        except ImportError as error:
            wanted = "what reads Open Sound Control (pip install 'samira-warp[drive]')"
            raise UserError("python-osc", expected=wanted, found="none") from error
        self._packet: Callable[[bytes], Any] = OscPacket
        self._fault: type[Exception] = ParseError
        self._shapes, self._pending = np.zeros(len(SHAPES)), np.zeros(len(SHAPES))
        self._turns: dict[str, np.ndarray] = {}

    def read(self, packet: bytes, seconds: float) -> FaceSignal | None:
        """The face after a datagram that came at a time; None where it says nothing of one.

        Raises:
            ValueError: It is no Open Sound Control, or a message has other arguments than its address means.
        """
        try:
            messages = [timed.message for timed in self._packet(packet).messages]
        except self._fault as fault:
            raise ValueError(f"it is no Open Sound Control: {fault}") from fault
        told = [self._take(message.address, message.params) for message in messages]
        return self._face(seconds) if any(told) else None

    def _face(self, seconds: float) -> FaceSignal:
        turns = self._turns
        neck, head = turns.get("Neck"), turns.get("Head")
        if neck is not None and head is not None:
            head = (Rotation.from_rotvec(neck) * Rotation.from_rotvec(head)).as_rotvec()
        eyes = None
        if "LeftEye" in turns and "RightEye" in turns:
            eyes = np.stack([turns["LeftEye"], turns["RightEye"]])
        return FaceSignal(seconds, self._shapes.copy(), neck if head is None else head, eyes)

    def _take(self, address: str, values: Sequence[Any]) -> bool:
        """Take a message in; whether the face may be another one by it."""
        if address == "/W":
            number, value = _numbers(address, values, 2)
            if number != int(number) or not 0 <= number < len(FACE_CAP_ORDER):
                raise ValueError(f"{address} has no shape {number:g}")
            self._shapes[NUMBER_OF[FACE_CAP_ORDER[int(number)]]] = value
        elif address == "/HR":
            self._turns["Head"] = turn_of(*np.radians(_numbers(address, values, 3)))
        elif address in ("/ELR", "/ERR"):
            down, left = np.radians(_numbers(address, values, 2))
            self._turns["LeftEye" if address == "/ELR" else "RightEye"] = turn_of(down, left, 0.0)
        elif address == "/VMC/Ext/Blend/Val":
            name, value = str(values[0]) if values else "", _numbers(address, values[1:], 1)[0]
            place = NUMBER_OF.get(known_shape(name) or "")
            if place is not None:
                self._pending[place] = value
            return False
        elif address == "/VMC/Ext/Blend/Apply":
            self._shapes = self._pending.copy()
        elif (
            address == "/VMC/Ext/Bone/Pos" and values and values[0] in ("Neck", "Head", "LeftEye", "RightEye")
        ):
            x, y, z, w = _numbers(address, values[4:], 4)
            if math.hypot(x, y, z, w) < 1e-6:
                raise ValueError(f"{address} has no rotation for {values[0]}")
            # Unity's x points the other way, to the figure's right
            self._turns[str(values[0])] = Rotation.from_quat([x, -y, -z, w]).as_rotvec()
        else:
            return False
        return True


def _numbers(address: str, values: Sequence[Any], count: int) -> list[float]:
    """The first arguments of a message, as numbers."""
    numbers = [float(value) for value in values[:count] if isinstance(value, (int, float))]
    if len(numbers) < count or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{address} has other arguments than its {count} numbers")
    return numbers
