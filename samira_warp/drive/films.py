"""A film as a source."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from samira_warp.data.video import read_facts, read_pictures
from samira_warp.drive.sources import FilmedPicture


class FilmSource:
    """The pictures of a video file."""

    live = False
    pictures = True

    def __init__(self, path: Path) -> None:
        """Look at its header and its first picture.

        Raises:
            UserError: It is no video, or cannot be decoded.
        """
        read_facts(path)
        self.name, self._path = str(path), path
        self._ended = False

    def frames(self, *, patience: float = math.inf) -> Iterator[FilmedPicture]:
        """The pictures as players show them.

        Raises:
            UserError: They end in a fault or too early.
        """
        for picture in read_pictures(self._path):
            if self._ended:
                return
            yield FilmedPicture(picture.seconds, picture.pixels())

    def end(self) -> None:
        """Give no more pictures."""
        self._ended = True
