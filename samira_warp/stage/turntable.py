"""How the light stands in each picture of a sequence, and how it goes round."""

from __future__ import annotations

from typing import NamedTuple

from samira_warp.avatar import DrivingFrame


class Shot(NamedTuple):
    """One frame and the pictures to make of it.

    Attributes:
        frame: The head and the camera.
        pictures: Name and degrees by which the light is turned further, of each picture.
    """

    frame: DrivingFrame
    pictures: tuple[tuple[str, float], ...]


def plan_shots(
    frames: list[DrivingFrame], *, turntable: float | None, frames_per_second: float
) -> list[Shot]:
    """The pictures of a rendered sequence, in order.

    Without a turntable, each frame is one picture. With it, a single frame is held for one whole turn, whose
    end meets its beginning, and is named NAME_0000, NAME_0001, ...; a longer sequence goes on as it is while
    the light turns.

    Args:
        frames: What to render.
        turntable: Seconds of one turn, or None.
        frames_per_second: Pictures a second.
    """
    if turntable is None:
        return [Shot(frame, ((frame.name, 0.0),)) for frame in frames]
    pictures_per_turn = turntable * frames_per_second
    if len(frames) > 1:
        return [
            Shot(frame, ((frame.name, 360.0 * index / pictures_per_turn),))
            for index, frame in enumerate(frames)
        ]
    count = max(round(pictures_per_turn), 1)
    return [
        Shot(
            frame,
            tuple((f"{frame.name}_{index:04d}", 360.0 * index / count) for index in range(count)),
        )
        for frame in frames
    ]
