"""``samira-warp prepare VIDEO``, or ``python -m samira_warp.prepare``: from a video to a dataset."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from samira_warp.prepare.config import PrepareConfig
from samira_warp.support.cli import run


def main(config: PrepareConfig) -> None:
    """Prepare, and say how to go on."""
    from samira_warp.prepare.run import prepare

    try:
        dataset = prepare(config)
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        raise
    flame = "" if config.vhap is None else " --flame FILE"
    print(f"{dataset} is ready: python -m samira_warp.train --data {dataset}{flame}", file=sys.stderr)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.prepare") -> int:
    """The verb from its options to its exit status."""
    return run(main, PrepareConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
