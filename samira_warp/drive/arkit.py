"""A face as phones send it: ARKit's 52 shapes by name, and how the head and the eyes are turned."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

_EYE = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")

SHAPES = (
    *(f"{name}Left" for name in _EYE),
    *(f"{name}Right" for name in _EYE),
    *("jawForward", "jawLeft", "jawRight", "jawOpen"),
    *("mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *("mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight"),
    *("mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight"),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *("mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight"),
    *("mouthUpperUpLeft", "mouthUpperUpRight"),
    *("browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    *("cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut"),
)
"""ARKit's blend shapes (ARFaceAnchor.BlendShapeLocation), in the order of Unreal's EARFaceBlendShape, in
which Live Link Face sends them. Left and right are the person's own."""

NUMBER_OF = {name: number for number, name in enumerate(SHAPES)}
"""Place of each in `SHAPES`."""

LOOK = 36.0
"""Degrees that an eye turns for 1 of an eyeLook shape: 34.6 to 41.8 in the frames that iFacialMocap's and
Facemotion3d's pages print, which have both."""


@dataclass(frozen=True, eq=False)
class FaceSignal:
    """One frame of a face.

    Turns are axis-angle rotations in radians about the head's own axes: x nods it down, y turns it to the
    person's left, z tilts it to the right shoulder.

    Attributes:
        seconds: When it was, from any beginning.
        shapes: (52,) float64 of `SHAPES`, 0 none to 1 all.
        head: (3,) float64 how the head is turned; None where that is not told.
        eyes: (2, 3) float64 how the left and the right eye are turned in the head; None likewise.
    """

    seconds: float
    shapes: np.ndarray
    head: np.ndarray | None = None
    eyes: np.ndarray | None = None

    @property
    def gaze(self) -> np.ndarray:
        """(2, 3) turns of the eyes, by the eyeLook shapes where nothing else tells."""
        return self.eyes if self.eyes is not None else gaze_of(self.shapes)

    def at(self, seconds: float) -> FaceSignal:
        """The same at another time."""
        return replace(self, seconds=seconds)


def turn_of(down: float, left: float, right: float) -> np.ndarray:
    """(3,) axis-angle radians of a head or an eye that first tilts, then nods, then turns.

    Args:
        down: Radians that it nods down.
        left: Radians that it turns to its left.
        right: Radians that it tilts to its right.
    """
    return Rotation.from_euler("YXZ", [left, down, right]).as_rotvec()


def gaze_of(shapes: np.ndarray) -> np.ndarray:
    """(2, 3) turns of the left and the right eye by the eyeLook shapes of (52,)."""

    def look(way: str, side: str) -> float:
        return float(shapes[NUMBER_OF[f"eyeLook{way}{side}"]])

    unit = np.radians(LOOK)
    down = [unit * (look("Down", side) - look("Up", side)) for side in ("Left", "Right")]
    left = (
        unit * (look("Out", "Left") - look("In", "Left")),
        unit * (look("In", "Right") - look("Out", "Right")),
    )
    return np.stack([turn_of(down[eye], left[eye], 0.0) for eye in (0, 1)])


def known_shape(name: str) -> str | None:
    """The one of `SHAPES` that a name means, in whatever spelling: eyeBlink_L, EyeBlinkLeft, eye_blink_left.

    None where it means none of them. browInnerUp_L is not browInnerUp: see `half_of`.
    """
    return _KNOWN.get(_plain(name))


def half_of(name: str) -> str | None:
    """The one of `SHAPES` whose one side a name means, such as cheekPuff for cheekPuff_L; None for others."""
    plain = _plain(name)
    side = next((side for side in ("left", "right") if plain.endswith(side)), None)
    return None if side is None or plain in _KNOWN else _KNOWN.get(plain.removesuffix(side))


def _plain(name: str) -> str:
    """A name without case, separators and short words for sides."""
    words = re.sub(r"[\W_]+", "_", name.strip())
    words = re.sub(r"_(L|R|l|r)$", lambda side: {"l": "left", "r": "right"}[side[1].lower()], words)
    return words.replace("_", "").lower()


_KNOWN = {name.lower(): name for name in SHAPES}
