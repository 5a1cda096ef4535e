"""``samira-warp check``, or ``python -m samira_warp.check``: what a dataset holds and what is wrong."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from samira_warp.check.config import CheckConfig
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

if TYPE_CHECKING:
    from samira_warp.check.report import Report


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
    print(report.json() if config.json else f"{report.text()}\n{_verdict(report, config.data)}")
    if report.sheet is not None:
        write_png(sheet, report.sheet)
        print(f"the mesh over its pictures: {sheet}", file=sys.stderr)
    if report.faults:
        raise UserError(
            config.data,
            expected="a dataset to train on",
            found=f"{report.faults} fault{'s' * (report.faults > 1)}",
        )


def _verdict(report: Report, data: Path) -> str:
    """The last line: whether training can begin, and how."""
    if report.faults:
        return "verdict:       cannot be trained on before its faults are mended"
    warnings = len(report.findings)
    judged = f" once somebody has judged its {warnings} warning{'s' * (warnings > 1)}" if warnings else ""
    return f"verdict:       can be trained on{judged}: python -m samira_warp.train --data {data}"


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.check") -> int:
    """The verb from its options to its exit status."""
    return run(main, CheckConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
