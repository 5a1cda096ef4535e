"""Make a copy of a dataset whose tracked parameters are the true ones, to tell what tracking noise costs.

usage: python tools/exact_tracking.py --data DIR --out DIR

The dataset brings gt/exact_parameters.npz: what its frames were rendered with, a row a timestep. Everything
but flame_param/ is linked.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from samira_warp.data import open_sequence
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class ExactConfig:
    """Make a copy of a dataset whose tracked parameters are the true ones."""

    data: Path
    """Dataset with gt/exact_parameters.npz."""
    out: Path
    """Folder to make."""


def main(config: ExactConfig) -> None:
    """Link what stays and write the parameters anew."""
    sequence = open_sequence(config.data)
    truth_path = config.data / "gt" / "exact_parameters.npz"
    if not truth_path.is_file():
        raise UserError(
            truth_path, expected="the parameters that the frames were rendered with", found="no such file"
        )
    if config.out.exists():
        raise UserError(config.out, expected="a new folder", found="one that exists")
    truth = np.load(truth_path)
    (config.out / "flame_param").mkdir(parents=True)
    for entry in config.data.resolve().iterdir():
        if entry.name != "flame_param":
            (config.out / entry.name).symlink_to(entry)
    for frame in sequence.frames:
        tracked = dict(np.load(frame.parameters_path))
        for name in truth.files:
            tracked[name] = truth[name][frame.timestep][None].astype(np.float32)
        np.savez(config.out / "flame_param" / frame.parameters_path.name, **tracked)


if __name__ == "__main__":
    sys.exit(run(main, ExactConfig, program="python tools/exact_tracking.py"))
