"""Frames of a video as picture files: cropped, resized, numbered."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from tqdm import tqdm

from samira_warp.data.video import Picture, VideoFacts, read_pictures
from samira_warp.io.images import resize_box, to_uint8
from samira_warp.prepare.crop import Crop

SAMPLES = 32
"""Pictures of a video in which the head is looked for."""

STILL_RATE = 25.0
"""Frames a second of a film of one picture."""

JPEG_QUALITY = 98
"""Of 100, with colour as fine as brightness: errors of one or two levels, which training would else learn."""


def frame_name(number: int) -> str:
    """The file of a frame; VHAP reads JPEG alone."""
    return f"{number:06d}.jpg"


def sampled(video: Path, facts: VideoFacts) -> Iterator[np.ndarray]:
    """About SAMPLES pictures (H, W, 3) uint8, evenly from a video's beginning to its end.

    Raises:
        UserError: The video is broken.
    """
    step = max(facts.count // SAMPLES, 1)
    for number, picture in enumerate(
        tqdm(read_pictures(video), total=facts.count or None, desc="looking for the head", unit="frame")
    ):
        if number % step == 0:
            yield picture.pixels()


@dataclass(frozen=True)
class Written:
    """Frames of a video.

    Attributes:
        count: How many there are.
        rate: How many there are a second.
    """

    count: int
    rate: float


def write_frames(
    video: Path, facts: VideoFacts, folder: Path, *, crop: Crop, size: int, fps: float | None
) -> Written:
    """Write the frames that are not there yet; each appears whole or not at all.

    Args:
        video: The video file.
        facts: Of the video.
        folder: Where to.
        crop: What to keep of each picture.
        size: Side of the frames, pixels; a crop is never enlarged.
        fps: Frames to take of a second, None for all.

    Raises:
        UserError: The video is broken.
        OSError: A frame cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    clear_unfinished(folder)
    side, count = min(size, crop.side), 0
    first = last = 0.0
    bar = tqdm(
        read_pictures(video), total=facts.count or None, desc="frames", unit="frame", dynamic_ncols=True
    )
    for picture in thinned(bar, fps):
        path = folder / frame_name(count)
        if not path.exists():
            kept = crop.of(picture.pixels()).astype(np.float32) / 255.0
            write_whole(path, resize_box(kept, width=side, height=side))
        first, last = (picture.seconds if count == 0 else first), picture.seconds
        count += 1
    return Written(count, (count - 1) / (last - first) if last > first else fps or STILL_RATE)


def thinned(pictures: Iterator[Picture], fps: float | None) -> Iterator[Picture]:
    """The first picture at or after every 1/fps of a second; all of them without fps."""
    due = None
    for picture in pictures:
        if fps is None:
            yield picture
        elif due is None or picture.seconds >= due - 1e-6:
            due = (picture.seconds if due is None else max(due, picture.seconds - 1.0 / fps)) + 1.0 / fps
            yield picture


def write_whole(path: Path, picture: np.ndarray) -> None:
    """Write a JPEG under a hidden name and rename it.

    By Pillow and in memory first: where the disk is full, OpenImageIO's writer of this format ends the
    process, and Pillow's, given a file, does not see that it is cut short.

    Args:
        path: Where to; its folder must exist.
        picture: (H, W, 3) or (H, W) display values in 0..1.

    Raises:
        OSError: It cannot be written.
    """
    encoded = io.BytesIO()
    Image.fromarray(to_uint8(picture)).save(encoded, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    fresh = path.with_name(f".{path.name}")
    try:
        fresh.write_bytes(encoded.getvalue())
        fresh.replace(path)
    except OSError as error:
        raise OSError(f"{path}: cannot be written: {error}") from error
    finally:
        fresh.unlink(missing_ok=True)


def clear_unfinished(folder: Path) -> None:
    """Remove what a killed process left half written: VHAP would read it."""
    for path in folder.glob(".*.jpg"):
        path.unlink()
