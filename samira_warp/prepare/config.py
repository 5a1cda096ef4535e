"""Options of the prepare verb."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from samira_warp.support.device_names import DeviceName
from samira_warp.support.errors import UserError
from samira_warp.support.image_size import check_side

USUAL_RATE = 25.0
"""Frames a second: faces move little between them, and a minute is 1,500 to track."""


@dataclass(frozen=True)
class PrepareConfig:
    """Make a dataset of a video of one head: frames, head crop, landmarks, mattes, tracking.

    Run the same command again after an interrupt, or after installing what was missing: a stage whose output
    is there is skipped, one that was begun goes on, and all that follow a stage with other inputs are done
    anew: with --restart alone where a tracking would be lost. OUT/dataset is what train reads.
    """

    video: Positional[Path]
    """Video file of one person before a camera that does not move."""
    out: Path
    """Folder of everything that is made."""
    size: int = 512
    """Side of the square frames, pixels; smaller where the crop is."""
    fps: float | None = USUAL_RATE
    """Frames to take of a second, where the video has more."""
    crop: str | None = None
    """Square of the video to keep, X,Y,SIDE in pixels from its upper left; default one about the head."""
    head: Path | None = None
    """Head model to track: a FLAME file, a template.npz, or a folder of ICT-FaceKit; default the built-in
    head."""
    mattes: Path | None = None
    """Folder of mattes made by another program, named as OUT/film/images; default Robust Video Matting's
    where it is installed, else a smaller network's."""
    keep_shoulders: bool = False
    """Keep what the mattes show below the neck."""
    models: Path | None = None
    """Folder of the networks' files, or of the wheels that they are in, where there is no network to fetch
    them from."""
    vhap: Path | None = None
    """Have VHAP track instead: its folder (a clone of github.com/ShenhanQian/VHAP with FLAME's files in its
    asset/flame)."""
    vhap_python: str = "conda run --no-capture-output -n VHAP python"
    """How to call the Python of VHAP's environment."""
    albedo: Path | None = None
    """Folder of albedo images by any intrinsic method, named as OUT/dataset/images or OUT/film/images; some
    may be missing."""
    refine: Path | None = None
    """Avatar (a run's folder) of the same person and head, by whose renderer pose and expression are refined
    in a copy of the dataset, OUT/refined."""
    restart: bool = False
    """Make anew what another video or other options ask for, although tracking is lost by it."""
    device: DeviceName = "auto"
    """Where mattes are computed: cpu, cuda, cuda:N, or auto, a GPU where there is one."""

    def check(self) -> None:
        """Raise UserError unless every number and folder can be used."""
        ranges = {
            "size": (self.size >= 16, "at least 16 pixels"),
            "fps": (self.fps is None or 0.0 < self.fps < math.inf, "a positive number of frames"),
        }
        for name, (holds, expected) in ranges.items():
            if not holds:
                raise UserError(f"--{name}", expected=expected, found=getattr(self, name))
        check_side("--size", self.size)
        for name in ("mattes", "albedo", "models", "refine"):
            folder = getattr(self, name)
            if folder is not None and not folder.is_dir():
                raise UserError(f"--{name} {folder}", expected="a folder", found="none there")
