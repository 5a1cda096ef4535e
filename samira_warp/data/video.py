"""Pictures of a video file, decoded by PyAV in the order in which they are shown."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np

from samira_warp.data.shown import Appearance, dynamic_range
from samira_warp.support.errors import UserError

WHOLE_SHARE = 0.9
"""A video whose pictures end before this share of the time that its header promises is cut off.

Time tells, the number of pictures does not: trimmed files count the ones that an edit list hides, and films
of uneven rate count empty slots.
"""

STILLS = ("image2", "ico")
"""What FFmpeg calls files of single pictures, besides those whose name ends in ``_pipe``."""


@dataclass(frozen=True)
class VideoFacts:
    """What a video's header says.

    Attributes:
        width: Of the pictures as they are shown, pixels.
        height: Of the pictures as they are shown, pixels.
        count: How many pictures there are; an estimate, 0 where nothing is known.
        dynamic_range: "HLG" or "PQ" where the pictures are of high dynamic range, else None.
    """

    width: int
    height: int
    count: int
    dynamic_range: str | None = None


def read_facts(path: Path) -> VideoFacts:
    """Look at a video's header and its first picture.

    Raises:
        UserError: The file is missing, is no video, or nothing in it can be decoded.
    """
    with _open(path) as container:
        if container.format.name in STILLS or container.format.name.endswith("_pipe"):
            raise UserError(path, expected="a video", found="a picture, in which nothing moves")
    picture = next(read_pictures(path), None)
    if picture is None:
        raise UserError(path, expected="a video", found="no picture in it")
    height, width = picture.pixels().shape[:2]
    with _open(path) as container:
        stream = container.streams.video[0]
        seconds = _promised_seconds(container, stream) or (container.duration or 0) / av.time_base
        count = round(seconds * float(stream.average_rate or 0)) or stream.frames
    return VideoFacts(width, height, count, dynamic_range(picture.frame))


class Picture(NamedTuple):
    """One picture of a video, not yet converted to colours.

    Attributes:
        seconds: When it is shown, from the video's beginning.
        frame: As it was decoded.
    """

    seconds: float
    frame: av.VideoFrame
    appearance: Appearance

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8 display values as players show them: upright, pixels square, in sRGB.

        Raises:
            UserError: As `Appearance.pixels`.
        """
        return self.appearance.pixels(self.frame)


def read_pictures(path: Path) -> Iterator[Picture]:
    """Decode a video from its beginning to its end.

    Raises:
        UserError: The file is missing or no video, or its pictures end in a fault or too early; the message
            says after how many.
    """
    with _open(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        appearance = Appearance.of(path, stream)
        done, first, end = 0, 0.0, 0.0
        try:
            for frame in container.decode(stream):
                seconds = frame.time if frame.time is not None else done / float(stream.average_rate or 25)
                if done == 0:
                    first, appearance = seconds, replace(appearance, size=appearance.shown_size(frame))
                end = max(end, seconds + _shown_for(frame, stream))
                yield Picture(seconds, frame, appearance)
                done += 1
        except av.error.FFmpegError as fault:
            found = f"{fault.strerror} after {done} of them"
            raise UserError(path, expected="pictures to its end", found=found) from fault
        promised = _promised_seconds(container, stream)
        if end - first < WHOLE_SHARE * promised:
            expected = f"pictures for {promised:.1f} s, as its header says"
            raise UserError(
                path, expected=expected, found=f"its end after {end - first:.1f} s, {done} of them"
            )


def _shown_for(frame: av.VideoFrame, stream: av.VideoStream) -> float:
    """Seconds for which a frame stays, by its own word or the mean rate."""
    if frame.duration and frame.time_base:
        return float(frame.duration * frame.time_base)
    return 1.0 / float(stream.average_rate or 25)


def _promised_seconds(container: av.container.InputContainer, stream: av.VideoStream) -> float:
    """For how long pictures are shown by the header's word; 0 where it has none.

    AVI's header counts slots of one length, empty ones among them; its index, from which FFmpeg takes the
    duration, is lost with the file's end. Matroska writes a stream's duration as a tag.
    """
    if container.format.name == "avi" and stream.frames and stream.average_rate:
        return stream.frames / float(stream.average_rate)
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    tag = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    if tag is None:
        return 0.0
    hours, minutes, seconds = (float(part) for part in tag.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def _open(path: Path) -> av.container.InputContainer:
    if not path.is_file():
        raise UserError(path, expected="a video file", found="a folder" if path.is_dir() else "no such file")
    try:
        container = av.open(str(path))
    except av.error.FFmpegError as fault:
        raise UserError(path, expected="a video that FFmpeg reads", found=fault.strerror) from fault
    if not container.streams.video:
        container.close()
        raise UserError(path, expected="a video", found="no pictures in it, only sound or text")
    return container
