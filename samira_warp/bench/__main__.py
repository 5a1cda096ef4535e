"""``python -m samira_warp.bench raster|light|avatar|train``: where the time goes."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from typing import Literal

import tyro

from samira_warp.cli import run
from samira_warp.devices import DeviceName, pick_device


@dataclass(frozen=True)
class BenchConfig:
    """Time a part of the package on this machine."""

    what: tyro.conf.Positional[Literal["raster", "light", "avatar", "train"]]
    """raster: kernels against plain ones or, on a GPU, gsplat; light: filtering; avatar: a frame, train: a step, by stage."""
    device: DeviceName = "auto"
    """Where to compute."""
    json: bool = False
    """Print JSON instead of a table."""


def main(config: BenchConfig) -> None:
    """Run one benchmark."""
    device = str(pick_device(config.device))
    importlib.import_module(f"samira_warp.bench.{config.what}").main(device, config.json)


if __name__ == "__main__":
    sys.exit(run(main, BenchConfig, program="python -m samira_warp.bench"))
