"""All that one browser has chosen: plain values, equal where the picture is equal."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from samira_warp.avatar import MaterialEdit
from samira_warp.head import FrameParameters
from samira_warp.stage.layer_names import Layer
from samira_warp.support.tone_names import ToneMap
from samira_warp.view.look import Look, Triple

LEARNED = "learned"
"""The name of the light that was learned with the avatar."""


@dataclass(frozen=True)
class Pose:
    """How the head is moved: a frame of the sequence, and what is added to it.

    Attributes:
        frame: Its number.
        neutral: Take the frame's place and turn of the head alone, and a face at rest.
        expression: What is added to coefficients, by their names; those of 0 are left out.
        joints: Axis-angle rotations, degrees, that joints make before the frame's own, by their names.
        live: What a source that drives the avatar gave last, in place of the frame; None where none does.
    """

    frame: int = 0
    neutral: bool = False
    expression: tuple[tuple[str, float], ...] = ()
    joints: tuple[tuple[str, Triple], ...] = ()
    live: FrameParameters | None = None

    @property
    def plain(self) -> bool:
        """Whether it is the frame as it is."""
        return not (self.neutral or self.expression or self.joints) and self.live is None


@dataclass(frozen=True)
class Lamp:
    """One round lamp far away.

    Attributes:
        azimuth: Degrees about the vertical: 0 before the face, 90 at the head's left.
        elevation: Degrees above the horizontal.
        strength: Radiance of a white card that faces it: 1 is a display's white.
    """

    azimuth: float = 45.0
    elevation: float = 30.0
    strength: float = 1.0


@dataclass(frozen=True)
class Light:
    """The light on the head.

    Attributes:
        name: Of the map, or `LEARNED`.
        rotate: Degrees by which it is turned, its lamp with it.
        stops: Of exposure: each doubles it. 0 is as learned, or automatic for a map.
        shadows: Whether the head blocks it.
        lamp: Added to the map; None for none.
    """

    name: str = LEARNED
    rotate: float = 0.0
    stops: float = 0.0
    shadows: bool = True
    lamp: Lamp | None = None


Beside = Literal["nothing", "light", "avatar"]
"""What the right part of a picture shows: the avatar under another light, or another one under the same."""


@dataclass(frozen=True)
class Comparison:
    """What the right part of a split picture shows.

    Attributes:
        of: What is there.
        light: The other light.
        split: Share of the picture's width at which the right part begins.
    """

    of: Beside = "nothing"
    light: Light = field(default_factory=Light)
    split: float = 0.5


@dataclass(frozen=True)
class State:
    """What is shown.

    Attributes:
        look: The camera.
        pose: The head.
        light: The light on it.
        edits: Changes to the materials.
        layer: What of it is drawn.
        tone_map: "auto" is filmic for a map, and none for the learned light.
        background: white, black, #rrggbb, or env.
        comparison: What is beside it.
        splats: Let the browser draw the avatar as splats: neither layers nor what is beside it.
    """

    look: Look
    pose: Pose = field(default_factory=Pose)
    light: Light = field(default_factory=Light)
    edits: tuple[MaterialEdit, ...] = ()
    layer: Layer = "image"
    tone_map: Literal["auto"] | ToneMap = "auto"
    background: str = "white"
    comparison: Comparison = field(default_factory=Comparison)
    splats: bool = False
