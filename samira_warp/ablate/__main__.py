"""``samira-warp ablate``, or ``python -m samira_warp.ablate``: what each part of the method is worth."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.ablate.config import AblateConfig
from samira_warp.support.cli import run


def main(config: AblateConfig) -> None:
    """Train, score, and print the tables; an early end by Ctrl-C becomes the shell's status for it."""
    from samira_warp.ablate.run import ablate

    tables = ablate(config)
    if tables is None:
        raise KeyboardInterrupt
    print(tables, end="")


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.ablate") -> int:
    """The verb from its options to its exit status."""
    return run(main, AblateConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
