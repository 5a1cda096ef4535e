"""``samira-warp export``, or ``python -m samira_warp.export``: an avatar for other programs."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.export.config import ExportConfig
from samira_warp.support.cli import run


def main(config: ExportConfig) -> None:
    """Write the file or the folder, and say what is in it."""
    config.check()  # before torch is loaded, which takes seconds
    from samira_warp.export.run import export

    written = export(config)
    print(f"{config.out}: {written}", file=sys.stderr)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.export") -> int:
    """The verb from its options to its exit status."""
    return run(main, ExportConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
