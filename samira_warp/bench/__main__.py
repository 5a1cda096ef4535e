"""``samira-warp bench WHAT``, or ``python -m samira_warp.bench``: where time and memory go."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Any

from samira_warp.bench.config import BenchConfig
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


def main(config: BenchConfig) -> None:
    """Run one benchmark."""
    from samira_warp.bench.gpu import pick_gpu
    from samira_warp.support.devices import pick_device

    if config.count and config.what != "train":
        raise UserError("--count", expected="bench train", found=f"bench {config.what}")
    if config.hdri is not None and config.what != "light":
        raise UserError("--hdri", expected="bench light", found=f"bench {config.what}")
    if config.film is not None and config.what != "drive":
        raise UserError("--film", expected="bench drive", found=f"bench {config.what}")
    if config.data is not None and config.what not in ("gpu", "memory"):
        raise UserError("--data", expected="bench gpu or bench memory", found=f"bench {config.what}")
    device = str((pick_gpu if config.what == "gpu" else pick_device)(config.device))
    of_its_own: dict[str, dict[str, Any]] = {
        "light": {"hdri": config.hdri},
        "drive": {"film": config.film},
        "train": {"count_work": config.count},
        "gpu": {"data": config.data},
        "memory": {"data": config.data},
    }
    options = of_its_own.get(config.what, {})
    importlib.import_module(f"samira_warp.bench.{config.what}").main(device, config.json, **options)


def command(arguments: Sequence[str] | None = None, program: str = "python -m samira_warp.bench") -> int:
    """The verb from its options to its exit status."""
    return run(main, BenchConfig, program=program, arguments=arguments)


if __name__ == "__main__":
    sys.exit(command())
