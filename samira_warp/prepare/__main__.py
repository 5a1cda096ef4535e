"""``python -m samira_warp.prepare VIDEO --out DIR``: from a video to a dataset that can be trained on."""

from __future__ import annotations

import sys

from samira_warp.prepare.config import PrepareConfig
from samira_warp.prepare.prepare import prepare
from samira_warp.support.cli import run


def main(config: PrepareConfig) -> None:
    """Prepare, and say how to go on."""
    try:
        dataset = prepare(config)
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        raise
    print(f"{dataset} is ready: python -m samira_warp.train --data {dataset} --flame FILE", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(run(main, PrepareConfig, program="python -m samira_warp.prepare"))
