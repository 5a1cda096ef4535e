"""``samira-warp compare``, or ``python -m samira_warp.compare``: training runs side by side."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.compare.config import CompareConfig
from samira_warp.support.cli import run


def main(config: CompareConfig) -> None:
    """Compare, and say where the report is."""
    from samira_warp.compare.run import compare

    print(compare(config))


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.compare") -> int:
    """The verb from its options to its exit status."""
    return run(main, CompareConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
