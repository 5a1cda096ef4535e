"""A training that is under way, seen from outside: its newest avatar, and its curves."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from samira_warp.avatar import Avatar
from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.train.begun import CONFIG_FILE
from samira_warp.train.metrics import read_metrics
from samira_warp.view.runs import newest_avatar

EVERY = 2.0
"""Seconds between two looks at the folder."""


class Progress(NamedTuple):
    """How far a run is.

    Attributes:
        steps: Of the whole run; 0 where it does not say.
        lines: Of metrics.jsonl, oldest first.
        shown: The name of the folder whose avatar is shown.
    """

    steps: int
    lines: tuple[dict[str, Any], ...]
    shown: str

    @classmethod
    def read(cls, run: Path, *, shown: Path) -> Progress:
        """What the run has written so far; a line that is being written is left for the next time."""
        steps = read_json(run / CONFIG_FILE).get("steps")
        return cls(steps if isinstance(steps, int) else 0, read_metrics(run), shown.name)

    def curve(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Steps and values, (n,) float64 each, of one number; one point at 0 before the first."""
        points = [(line["step"], line[name]) for line in self.lines if name in line] or [(0, 0.0)]
        steps, values = np.asarray(points, dtype=np.float64).T
        return steps.copy(), values.copy()

    def words(self) -> str:
        """How far it is, in a line."""
        done = self.lines[-1]["step"] if self.lines else 0
        of = f" of {self.steps:,}" if self.steps else ""
        return f"**Step {done:,}{of}**, shown: `{self.shown}`"


class Follower:
    """A thread that looks for a run's next avatar and for what it has logged since."""

    def __init__(self, run: Path, shown: Path, *, device: torch.device) -> None:
        """Follow a run.

        Args:
            run: Its folder.
            shown: The folder of the avatar that is shown first.
            device: Where avatars go.
        """
        self.progress = Progress.read(run, shown=shown)
        self._run, self._shown, self._device = run, shown, device
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(
        self, *, on_avatar: Callable[[Avatar, Path], None], on_progress: Callable[[Progress], None]
    ) -> None:
        """Begin to look, in a thread of its own.

        Args:
            on_avatar: Called with each newer avatar and its folder.
            on_progress: Called where the run has written more.
        """

        def follow() -> None:
            while not self._ended.wait(EVERY):
                self.look(on_avatar=on_avatar, on_progress=on_progress)

        self._thread = threading.Thread(target=follow, name="follower", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Look no more."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(EVERY)

    def look(
        self, *, on_avatar: Callable[[Avatar, Path], None], on_progress: Callable[[Progress], None]
    ) -> None:
        """Look once: a folder that is being replaced or written is left for the next time."""
        try:
            newest = newest_avatar(self._run)
            if newest != self._shown:
                avatar = Avatar.load(newest, device=self._device)
                self._shown = newest
                on_avatar(avatar, newest)
            progress = Progress.read(self._run, shown=self._shown)
        except (UserError, OSError):
            return
        if progress != self.progress:
            self.progress = progress
            on_progress(progress)
