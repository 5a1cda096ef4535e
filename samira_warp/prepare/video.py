"""Pictures of a video file, decoded by PyAV in the order in which they are shown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np

from samira_warp.support.errors import UserError

WHOLE_SHARE = 0.9
"""A video that ends before this share of the pictures that its header counts is cut off; edit lists hide a
few of every whole one."""


class VideoFacts(NamedTuple):
    """What a video's header says.

    Attributes:
        width: Of the pictures as they are shown, pixels.
        height: Of the pictures as they are shown, pixels.
        count: How many pictures there are; an estimate, 0 where nothing is known.
    """

    width: int
    height: int
    count: int


def read_facts(path: Path) -> VideoFacts:
    """Look at a video's header and its first picture.

    Raises:
        UserError: The file is missing, is no video, or nothing in it can be decoded.
    """
    picture = next(read_pictures(path), None)
    if picture is None:
        raise UserError(path, expected="a video", found="no picture in it")
    height, width = picture.pixels().shape[:2]
    with _open(path) as container:
        stream = container.streams.video[0]
        seconds = (
            float(stream.duration * stream.time_base)
            if stream.duration
            else (container.duration or 0) / av.time_base
        )
        count = stream.frames or round(seconds * float(stream.average_rate or 0))
    return VideoFacts(width, height, count)


class Picture(NamedTuple):
    """One picture of a video, not yet converted to colours.

    Attributes:
        seconds: When it is shown, from the video's beginning.
        frame: As it was decoded.
    """

    seconds: float
    frame: av.VideoFrame

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8 display values, upright: phones store portrait videos lying on their side."""
        lying = self.frame.to_ndarray(format="rgb24")
        return np.ascontiguousarray(np.rot90(lying, self.frame.rotation // 90))


def read_pictures(path: Path) -> Iterator[Picture]:
    """Decode a video from its beginning to its end.

    Raises:
        UserError: The file is missing or no video, or its pictures end in a fault or too early; the message
            says after how many.
    """
    with _open(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        done = 0
        try:
            for frame in container.decode(stream):
                yield Picture(
                    float(frame.time) if frame.time is not None else done / float(stream.average_rate or 25),
                    frame,
                )
                done += 1
        except av.error.FFmpegError as fault:
            raise UserError(
                path, expected="pictures to its end", found=f"{fault.strerror} after {done} of them"
            ) from fault
        if done < WHOLE_SHARE * stream.frames:
            raise UserError(
                path, expected=f"{stream.frames} pictures, as its header says", found=f"its end after {done}"
            )


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
