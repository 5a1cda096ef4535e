"""Which frames of a sequence are meant, by number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from samira_warp.support.errors import UserError

Frame = TypeVar("Frame")


def parse_frames(text: str | None) -> slice:
    """Read what ``--frames`` says: A:B:STEP, any part of which may be left out, or one number.

    Raises:
        UserError: It is not of that form.
    """
    if text is None:
        return slice(None)
    parts = text.split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
        if len(numbers) > 3 or (len(numbers) == 3 and numbers[2] == 0):
            raise ValueError
    except ValueError:
        raise UserError(
            "--frames", expected="A:B:STEP, whole numbers, any of which may be left out", found=repr(text)
        ) from None
    if len(numbers) == 1:
        first = numbers[0]
        if first is None:
            raise UserError("--frames", expected="A:B:STEP", found=repr(text))
        return slice(first, first + 1 or None)
    return slice(*numbers)


def chosen_frames(frames: Sequence[Frame], text: str | None) -> Sequence[Frame]:
    """The frames that ``--frames`` names, in its order.

    Raises:
        UserError: There are none, or it is not of its form.
    """
    chosen = frames[parse_frames(text)]
    if not chosen:
        found = f"none in {text or 'the split'}"
        raise UserError("--frames", expected=f"some of the {len(frames)} frames", found=found)
    return chosen


def frame_at(frames: Sequence[Frame], number: int) -> Frame:
    """The frame that ``--frame`` names, counted from 0.

    Raises:
        UserError: There is none of that number.
    """
    if not 0 <= number < len(frames):
        raise UserError("--frame", expected=f"0 to {len(frames) - 1}", found=number)
    return frames[number]
