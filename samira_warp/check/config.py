"""Options of the check verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class CheckConfig:
    """Say what a dataset holds and all that is wrong with it.

    The tracked mesh is drawn over a dozen of its frames. The exit status is 0 where it can be trained on, and
    2 where anything stands against it.
    """

    data: Path
    """Folder of the dataset."""

    split: str = "dataset"
    """How to divide it: train or test (both the dataset's own), a fraction, or last:N."""

    flame: Path | None = None
    """FLAME's file (.pkl or .npz, with its UV coordinates and masks beside it), or a template.npz, for a
    dataset without one."""

    out: Path | None = None
    """Where to write the contact sheet, a PNG; default <folder's name>_check.png in the working directory."""

    quick: bool = False
    """What train does before it begins: decode no pictures but the masks of a dozen frames, and draw
    nothing."""

    json: bool = False
    """Print a JSON object instead of lines."""
