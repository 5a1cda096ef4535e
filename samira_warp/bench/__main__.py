"""``python -m samira_warp.bench raster|light|avatar|train``: where the time goes."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from typing import Literal

import torch
import tyro

from samira_warp.cli import run
from samira_warp.errors import UserError


@dataclass(frozen=True)
class BenchConfig:
    """Time a part of the package on this machine."""

    what: tyro.conf.Positional[Literal["raster", "light", "avatar", "train"]]
    """raster: kernels against plain ones; light: filtering; avatar: a frame by stage; train: a step by stage."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute."""
    json: bool = False
    """Print JSON instead of a table."""


def main(config: BenchConfig) -> None:
    """Run one benchmark."""
    gpu = torch.cuda.is_available()
    if config.device == "cuda" and not gpu:
        raise UserError("--device cuda", expected="a CUDA device that torch can use", found="none")
    device = "cuda" if config.device != "cpu" and gpu else "cpu"
    importlib.import_module(f"samira_warp.bench.{config.what}").main(device, config.json)


if __name__ == "__main__":
    sys.exit(run(main, BenchConfig, program="python -m samira_warp.bench"))
