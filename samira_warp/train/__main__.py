"""``samira-warp train``, or ``python -m samira_warp.train``: from a tracked video to an avatar."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.support.cli import run
from samira_warp.train.config import TrainConfig


def main(config: TrainConfig) -> None:
    """Train; an early end by Ctrl-C becomes the shell's status for it."""
    from samira_warp.train.run import train

    if train(config) is None:
        raise KeyboardInterrupt


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.train") -> int:
    """The verb from its options to its exit status."""
    return run(main, TrainConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
