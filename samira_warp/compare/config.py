"""Options of the compare verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from samira_warp.support.device_names import DeviceName
from samira_warp.support.errors import UserError

FORMATS: dict[str, Literal["html", "markdown"]] = {
    ".html": "html",
    ".htm": "html",
    ".md": "markdown",
    ".markdown": "markdown",
}
"""What is written, by the suffix of the report's name."""


@dataclass(frozen=True)
class CompareConfig:
    """Put training runs side by side in one report.

    It has the settings that differ, scores, curves, and pictures of the same test frames with their errors.
    The runs have finished, on the same data.
    """

    runs: Positional[tuple[Path, ...]]
    """Run folders, two or more; the others are compared with the first."""
    out: Path
    """The report: NAME.html holds its pictures, beside NAME.md they are in a folder NAME_pictures."""
    frames: int = 4
    """Test frames to show, evenly spaced; all of them where there are fewer."""
    data: Path | None = None
    """The dataset's folder, where it is no longer where the runs found it."""
    regions: Path | None = None
    """Folder of label images of the test frames, with their names in parse.json there or one folder up:
    scores by region; default the dataset's gt/parse, where it has one."""
    device: DeviceName = "auto"
    """Where to render: cpu, cuda, cuda:N, or auto, a GPU where there is one."""

    @property
    def format(self) -> Literal["html", "markdown"]:
        """What is written."""
        return FORMATS[self.out.suffix.lower()]

    def check(self) -> None:
        """Raise UserError unless the options can be meant."""
        if len(self.runs) < 2:
            raise UserError("RUNS", expected="two run folders or more", found=len(self.runs) or "none")
        if self.frames < 1:
            raise UserError("--frames", expected="a positive number", found=self.frames)
        if self.out.suffix.lower() not in FORMATS:
            expected = f"a name that ends in {' or '.join(FORMATS)}"
            raise UserError("--out", expected=expected, found=self.out)
        if self.out.is_dir():
            raise UserError(self.out, expected="a file", found="a folder")
