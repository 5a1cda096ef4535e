"""What may drive an avatar, by what is typed for it: a film, a camera, a recording, a port for phones."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from samira_warp.drive.arkit import FaceSignal
from samira_warp.support.errors import UserError

SOURCES = "a film, a camera (its number or device), a Live Link Face .csv, or udp://HOST:PORT"

CAMERA = re.compile(r"\d+|/dev/video\d+")


class FilmedPicture(NamedTuple):
    """One picture of a film or of a camera.

    Attributes:
        seconds: When it is shown, from any beginning.
        picture: (H, W, 3) uint8 display values, upright.
    """

    seconds: float
    picture: np.ndarray


class Source(Protocol):
    """Where a face comes from, picture by picture or signal by signal."""

    name: str
    """What it is called in messages."""
    live: bool
    """Whether it comes when it comes, and ends when somebody ends it."""
    pictures: bool
    """Whether it gives pictures; else signals."""

    def frames(self, *, patience: float = math.inf) -> Iterator[FilmedPicture | FaceSignal]:
        """What comes, in order, as soon as it is there; of a source that is not live as fast as it is taken.

        Args:
            patience: Seconds of silence, after the first frame, that end a live source.

        Raises:
            UserError: It cannot be read on.
        """
        ...

    def end(self) -> None:
        """Let `frames` end soon, from any thread."""
        ...


def open_source(text: str) -> Source:
    """Open what an option names.

    Raises:
        UserError: There is no such thing, or it cannot be used.
    """
    from samira_warp.drive.cameras import CameraSource
    from samira_warp.drive.films import FilmSource
    from samira_warp.drive.takes import TakeSource
    from samira_warp.drive.udp import UdpSource

    if text.startswith("udp:"):
        return UdpSource(text)
    if CAMERA.fullmatch(text):
        return CameraSource(text)
    if "://" in text:
        raise UserError("--drive", expected=SOURCES, found=repr(text))
    path = Path(text)
    if not path.exists():
        raise UserError("--drive", expected=SOURCES, found=f"no such file: {text}")
    return TakeSource(path) if path.suffix.lower() == ".csv" else FilmSource(path)
