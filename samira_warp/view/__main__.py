"""``samira-warp view``, or ``python -m samira_warp.view``: an avatar in the browser."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.support.cli import run
from samira_warp.view.config import ViewConfig


def main(config: ViewConfig) -> None:
    """Show the avatar until the process is told to end."""
    from samira_warp.view.run import view

    view(config)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.view") -> int:
    """The verb from its options to its exit status."""
    return run(main, ViewConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
