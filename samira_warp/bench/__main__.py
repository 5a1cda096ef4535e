"""``python -m samira_warp.bench raster|light|avatar|train``: where the time goes."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from samira_warp.support.cli import run
from samira_warp.support.device_names import DeviceName
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class BenchConfig:
    """Time a part of the package on this machine."""

    what: tyro.conf.Positional[Literal["raster", "light", "avatar", "train"]]
    """raster: kernels against plain ones or, on a GPU, gsplat; light: filtering; avatar: a frame, train: a
    step, by stage."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""
    json: bool = False
    """Print JSON instead of a table."""
    hdri: Path | None = None
    """light: also shade a sphere and a head under every map of this folder, against Monte Carlo (minutes)."""


def main(config: BenchConfig) -> None:
    """Run one benchmark."""
    device = str(pick_device(config.device))
    if config.hdri is not None and config.what != "light":
        raise UserError("--hdri", expected="bench light", found=f"bench {config.what}")
    options = {"hdri": config.hdri} if config.what == "light" else {}
    importlib.import_module(f"samira_warp.bench.{config.what}").main(device, config.json, **options)


if __name__ == "__main__":
    sys.exit(run(main, BenchConfig, program="python -m samira_warp.bench"))
