"""A whole source, one frame after the other, as frames to render."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence

from samira_warp.drive.performer import Performance, Performer, Seen
from samira_warp.drive.sources import Source
from samira_warp.support.errors import UserError

STOPPED = 3.0
"""Seconds of silence that end the recording of a live source that had begun."""


def record(source: Source, performer: Performer, *, neutral: int | None) -> list[Performance]:
    """All frames of a source; a live one until it stops, or until Ctrl-C, which ends it and nothing else.

    Args:
        source: Where they come from.
        performer: What makes poses of them.
        neutral: The frame that all of them are relative to; None for the first.

    Raises:
        UserError: No frame came, none shows a face, or the neutral one is not there.
    """
    seen: list[Seen] = []
    try:
        for item in source.frames(patience=STOPPED):
            seen += performer.see(item)
    except KeyboardInterrupt:
        if not source.live:
            raise
        print(f"{source.name}: recorded until Ctrl-C; a second one ends all", file=sys.stderr)
    finally:
        source.end()
    seen += performer.close()
    faces = [one for one in seen if one.face is not None]
    if not faces:
        found = f"none in {len(seen)}" + (f" (the first: {seen[0].reason})" if seen else "")
        raise UserError(source.name, expected="frames that show a face", found=found)
    _say_lost(source, seen)
    if neutral is not None:
        chosen = next((one for one in faces if one.number == neutral), None)
        if chosen is None:
            expected = f"a frame from 0 to {seen[-1].number} that shows a face"
            raise UserError("--neutral", expected=expected, found=neutral)
        performer.take_for_neutral(chosen)
    return [performer.perform(one) for one in seen]


def sampled(frames: Sequence[Performance], rate: float) -> Iterator[Performance]:
    """The frames of a rate: of each moment the newest at that moment, the first one at the first.

    Args:
        frames: In order, at least one.
        rate: Frames a second.
    """
    first, last = frames[0].seconds, frames[-1].seconds
    at = 0
    for moment in itertools.count():
        seconds = first + moment / rate
        if seconds > last + 1e-6:
            return
        while at + 1 < len(frames) and frames[at + 1].seconds <= seconds + 1e-6:
            at += 1
        yield frames[at]


def _say_lost(source: Source, seen: Sequence[Seen]) -> None:
    """Say in which frames no face is seen."""
    lost = [one for one in seen if one.face is None]
    if lost:
        numbers = ranges([one.number for one in lost])
        reason = f"the first: {lost[0].reason}"
        print(
            f"warning: {source.name}: no face in frame{'s' * (len(lost) > 1)} {numbers} ({reason}); "
            "the pose before is held",
            file=sys.stderr,
        )


def ranges(numbers: Sequence[int]) -> str:
    """Rising numbers in words: 3-5, 9."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{first}-{last}" if last > first else f"{first}" for first, last in runs)
