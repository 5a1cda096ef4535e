"""A recording of Live Link Face as a source."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from samira_warp.drive.arkit import FaceSignal
from samira_warp.drive.live_link_csv import read_recording


class TakeSource:
    """All rows of a file that show a face."""

    live = False
    pictures = False

    def __init__(self, path: Path) -> None:
        """Read all of it.

        Raises:
            UserError: As `read_recording`.
        """
        self.name = str(path)
        self._frames = read_recording(path).frames
        self._ended = False

    def frames(self, *, patience: float = math.inf) -> Iterator[FaceSignal]:
        """The rows."""
        for frame in self._frames:
            if self._ended:
                return
            yield frame

    def end(self) -> None:
        """Give no more rows."""
        self._ended = True
