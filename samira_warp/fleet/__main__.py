"""``samira-warp fleet``, or ``python -m samira_warp.fleet``: many subjects on many machines."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.fleet.config import FleetConfig
from samira_warp.support.cli import run


def main(config: FleetConfig) -> None:
    """Do what the manifest lists, and print the table of results."""
    from samira_warp.fleet.run import fleet

    fleet(config)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.fleet") -> int:
    """The verb from its options to its exit status."""
    return run(main, FleetConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
