"""Options of the view verb."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from samira_warp.render.config import check_drive
from samira_warp.support.device_names import DeviceName
from samira_warp.support.errors import UserError

LEAST_SIDE, MOST_SIDE = 256, 2048
"""Pixels that --resolution may ask for."""


@dataclass(frozen=True)
class ViewConfig:
    """Look at an avatar in a browser: move it, light it, change it, and take pictures.

    Pictures are rendered here, as `render` renders them, and sent to every browser that opens the page.
    Ctrl-C ends it.
    """

    avatar: Path | None = None
    """Avatar folder, or the run folder that it is in."""
    run: Path | None = None
    """In place of --avatar, a run folder whose training is under way: its newest checkpoint is shown, the
    next one as soon as it is there, and the curves of its losses."""
    compare: Path | None = None
    """A second avatar, to be shown beside the first in one picture."""
    data: Path | None = None
    """Sequence that drives the avatar; default its own frames."""
    drive: str | None = None
    """What drives the avatar live: a camera (its number or device), udp://HOST:PORT for phones, a film, or a
    recording of Live Link Face (.csv), which are played once."""
    neutral: int | None = None
    """Frame of --drive, counted from 0, whose face is neutral; default the first ones of a camera or a film,
    zeros for the others. A button of the page takes the face of the moment."""
    smoothing: float = 1.0
    """Of --drive, against jitter: 0 is none, 2 twice as much."""
    split: str | None = None
    """Frames of --data: train or test, a fraction, or last:N; default as render takes them."""
    envs: Path | None = None
    """Folder of environment maps (.hdr, .exr), offered beside the learned light and the package's own."""
    port: int = 8080
    """Port of the page; 0 takes a free one."""
    host: str = "localhost"
    """Where the page can be opened from: localhost is this machine alone, 0.0.0.0 every other one too."""
    resolution: int = 1024
    """Longer side of pictures at rest, pixels, where the browser's window has as many."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""

    def check(self) -> None:
        """Raise UserError unless the options go together."""
        if (self.avatar is None) == (self.run is None):
            raise UserError(
                "--avatar", expected="it or --run, one of them", found="both" if self.avatar else "neither"
            )
        if not 0 <= self.port <= 65535:
            raise UserError("--port", expected="0 to 65535", found=self.port)
        if not LEAST_SIDE <= self.resolution <= MOST_SIDE:
            expected = f"{LEAST_SIDE} to {MOST_SIDE} pixels"
            raise UserError("--resolution", expected=expected, found=self.resolution)
        check_drive(self.drive, data=self.data, split=self.split, neutral=self.neutral)
        if not 0.0 <= self.smoothing < math.inf:
            raise UserError("--smoothing", expected="0 or more", found=self.smoothing)
        if self.split is not None and self.data is None:
            raise UserError("--split", expected="--data with it", found="none")
