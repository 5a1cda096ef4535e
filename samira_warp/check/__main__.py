"""``samira-warp check``, or ``python -m samira_warp.check``: what a dataset holds and what is wrong."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from samira_warp.check.config import CheckConfig
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


def main(config: CheckConfig) -> None:
    """Check, print and draw.

    Raises:
        UserError: The folder cannot be read at all, or there are faults.
    """
    from samira_warp.check.report import check_dataset
    from samira_warp.io.files import check_writable
    from samira_warp.io.images import write_png

    sheet = config.out or Path(f"{config.data.resolve().name}_check.png")
    if sheet.suffix.lower() != ".png" or not sheet.parent.is_dir():
        raise UserError("--out", expected="a .png in a folder that is there", found=config.out)
    if not config.quick:
        check_writable(sheet.parent)
    report = check_dataset(config.data, split=config.split, flame=config.flame, quick=config.quick)
    try:
        if report.sheet is not None:
            write_png(sheet, report.sheet)
            print(f"the mesh over its pictures: {sheet}", file=sys.stderr)
    finally:  # whether or not there is room for the sheet; the verdict is the last line
        print(report.json() if config.json else report.text())
    if report.faults:
        raise UserError(
            config.data,
            expected="a dataset to train on",
            found=f"{report.faults} fault{'s' * (report.faults > 1)}",
        )


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.check") -> int:
    """The verb from its options to its exit status."""
    return run(main, CheckConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
