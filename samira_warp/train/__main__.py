"""``python -m samira_warp.train``: from a tracked video to an avatar."""

from __future__ import annotations

import sys

from samira_warp.support.cli import run
from samira_warp.train.config import TrainConfig
from samira_warp.train.run import train


def main(config: TrainConfig) -> None:
    """Train; an early end by Ctrl-C becomes the shell's status for it."""
    if train(config) is None:
        raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(run(main, TrainConfig, program="python -m samira_warp.train"))
