"""``python -m samira_warp.check``: says what a dataset holds and all that is wrong with it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from samira_warp.check.report import check_dataset
from samira_warp.io.images import write_png
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


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


def main(config: CheckConfig) -> None:
    """Check, print and draw.

    Raises:
        UserError: The folder cannot be read at all, or there are faults.
    """
    if config.out is not None and (config.out.suffix.lower() != ".png" or not config.out.parent.is_dir()):
        raise UserError("--out", expected="a .png in a folder that is there", found=config.out)
    report = check_dataset(config.data, split=config.split, flame=config.flame, quick=config.quick)
    print(report.json() if config.json else report.text())
    if report.sheet is not None:
        path = config.out or Path(f"{config.data.resolve().name}_check.png")
        write_png(path, report.sheet)
        print(f"the mesh over its pictures: {path}", file=sys.stderr)
    if report.faults:
        raise UserError(
            config.data,
            expected="a dataset to train on",
            found=f"{report.faults} fault{'s' * (report.faults > 1)}",
        )


if __name__ == "__main__":
    sys.exit(run(main, CheckConfig, program="python -m samira_warp.check"))
