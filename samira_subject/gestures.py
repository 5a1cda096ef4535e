"""What a face does, by the names of the shapes that do it."""

from __future__ import annotations

from dataclasses import dataclass, field

SIDES = ("", "_L", "_R")
"""What may follow a shape's name: a gesture that names no side moves both."""


@dataclass(frozen=True)
class Gesture:
    """A pose of part of the face.

    Attributes:
        shapes: Coefficients of expression shapes by name, with a side or without.
        jaw: Share of the widest opening.
    """

    shapes: dict[str, float] = field(default_factory=dict)
    jaw: float = 0.0


UPPER = (
    Gesture({"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.5}),
    Gesture({"browDown": 1.0, "eyeSquint": 0.5, "noseSneer": 0.2}),
    Gesture({"browInnerUp": 1.0, "browDown": 0.3}),
    Gesture({"eyeWide": 1.0, "browOuterUp": 0.5, "browInnerUp": 0.3}),
    Gesture({"eyeSquint": 1.0, "cheekSquint": 0.7, "browDown": 0.3}),
    Gesture({"noseSneer": 0.9, "browDown": 0.5, "eyeSquint": 0.3}),
    Gesture({"browOuterUp_L": 0.9, "browDown_R": 0.6}),
    Gesture({"browOuterUp_R": 0.9, "browDown_L": 0.6}),
)
"""Brows, eyes and nose."""

LOWER = (
    Gesture({"mouthSmile": 0.9, "cheekSquint": 0.4, "mouthDimple": 0.6}),
    Gesture({"mouthFunnel": 0.7}, jaw=0.4),
    Gesture({"mouthPucker": 0.9}),
    Gesture({}, jaw=1.0),
    Gesture({"mouthFrown": 0.9, "mouthShrugLower": 0.5}),
    Gesture({"mouthSmile": 0.8, "mouthUpperUp": 0.5, "mouthLowerDown": 0.3}, jaw=0.35),
    Gesture({"cheekPuff": 0.9, "mouthPress": 0.4}),
    Gesture({"mouthStretch": 0.8, "mouthLowerDown": 0.5}, jaw=0.15),
    Gesture({"mouthPress": 0.9, "mouthRollLower": 0.5, "mouthRollUpper": 0.5}),
    Gesture({"mouthLeft": 0.8, "jawLeft": 0.5, "mouthSmile_L": 0.4}),
    Gesture({"mouthRight": 0.8, "jawRight": 0.5, "mouthSmile_R": 0.4}),
    Gesture({"mouthUpperUp": 0.8, "noseSneer": 0.5}, jaw=0.1),
    Gesture({"mouthShrugUpper": 0.8, "mouthRollLower": 0.4}, jaw=0.2),
    Gesture({"jawForward": 0.8, "mouthShrugLower": 0.4}, jaw=0.1),
)
"""Mouth, cheeks and chin."""

SPEECH = (
    Gesture({"mouthStretch": 0.25, "mouthUpperUp": 0.15}, jaw=0.35),
    Gesture({"mouthFunnel": 0.35}, jaw=0.25),
    Gesture({"mouthPress": 0.3, "mouthRollLower": 0.15}),
    Gesture({"mouthPucker": 0.45}, jaw=0.08),
    Gesture({"mouthLowerDown": 0.35}, jaw=0.2),
)
"""What the mouth passes through in talking."""

BLINK = "eyeBlink"
"""How the names of the shapes that close the eyes begin."""


def shapes_of(gesture: Gesture, names: tuple[str, ...]) -> dict[int, float]:
    """A gesture's coefficients by index, of those shapes that there are."""
    index_of = {name: index for index, name in enumerate(names)}
    return {
        index_of[name + side]: value
        for name, value in gesture.shapes.items()
        for side in SIDES
        if name + side in index_of
    }
