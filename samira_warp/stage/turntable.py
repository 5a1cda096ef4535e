"""How light and camera stand in each picture of a sequence, and how they go round."""

from __future__ import annotations

from typing import NamedTuple

from samira_warp.avatar import DrivingFrame
from samira_warp.geometry.camera import Camera
from samira_warp.stage.viewpoint import Orbit


class Picture(NamedTuple):
    """One picture of a frame.

    Attributes:
        name: Stem of its files.
        camera: Who looks.
        degrees: By which the light is turned further.
    """

    name: str
    camera: Camera
    degrees: float = 0.0


class Shot(NamedTuple):
    """One frame and the pictures to make of it.

    Attributes:
        frame: The head, and the camera of the first picture.
        pictures: At least one.
    """

    frame: DrivingFrame
    pictures: tuple[Picture, ...]


def plan_shots(
    frames: list[DrivingFrame],
    *,
    turntable: float | None = None,
    orbit: Orbit | None = None,
    frames_per_second: float,
) -> list[Shot]:
    """The pictures of a rendered sequence, in order.

    Where nothing goes round, each frame is one picture. Else a single frame is held for one whole turn, whose
    end meets its beginning, and is named NAME_0000, NAME_0001, ...; of two turns, for the longer one. A
    longer sequence goes on as it is while light, camera or both turn.

    Args:
        frames: What to render.
        turntable: Seconds of one turn of the light, or None.
        orbit: The turn of the camera, which then is the frames' own no more; or None.
        frames_per_second: Pictures a second.
    """
    held = len(frames) == 1
    light = _Turn.lasting(turntable, frames_per_second, held=held)
    camera = _Turn.lasting(orbit and orbit.seconds, frames_per_second, held=held)
    if light is None and camera is None:
        return [Shot(frame, (Picture(frame.name, frame.camera),)) for frame in frames]

    def picture(frame: DrivingFrame, name: str, index: int) -> Picture:
        seen_by = frame.camera if orbit is None or camera is None else orbit.camera(camera.degrees(index))
        return Picture(name, seen_by, 0.0 if light is None else light.degrees(index))

    if not held:
        each: list[tuple[Picture, ...]] = [
            (picture(frame, frame.name, index),) for index, frame in enumerate(frames)
        ]
    else:
        (frame,), count = frames, max(round(turn.pictures) for turn in (light, camera) if turn is not None)
        each = [tuple(picture(frame, f"{frame.name}_{index:04d}", index) for index in range(count))]
    return [
        Shot(frame._replace(camera=pictures[0].camera), pictures)
        for frame, pictures in zip(frames, each, strict=True)
    ]


class _Turn(NamedTuple):
    """A whole turn, and how many pictures it takes."""

    pictures: float

    @classmethod
    def lasting(cls, seconds: float | None, frames_per_second: float, *, held: bool) -> _Turn | None:
        """A turn of so many seconds; of a held frame it takes a whole number of pictures."""
        if seconds is None:
            return None
        count = seconds * frames_per_second
        return cls(max(round(count), 1) if held else count)

    def degrees(self, index: int) -> float:
        return 360.0 * index / self.pictures
