"""Options of the fleet verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class FleetConfig:
    """Prepare, train, evaluate and export many subjects, on this machine or on a cluster, by Ray.

    Run the same command again after an interrupt: stages that have finished are kept, and a training that was
    stopped goes on. OUT/fleet.md has the results of all subjects, fleet.json the same for programs.
    """

    manifest: Positional[Path]
    """What to do: a TOML file with the subjects, their options, and what the stages take of a machine
    (docs/scale.md)."""
    out: Path
    """Folder of everything that is made, a folder a subject; all machines have to see it under this name."""
    address: str | None = None
    """Cluster to work on: auto, the one that this machine is part of, or HOST:PORT; default a Ray of this
    machine's own, which ends with the command."""
    retries: int = 2
    """How often a stage is tried again whose process crashed, or whose machine was lost. A mistake in a
    subject's data is final."""
    row: int | None = None
    """Do one subject, counted from 0, in this process and without Ray: what the tasks of --slurm do."""
    slurm: Path | None = None
    """Do nothing but write a job script for SLURM to this file: an array with a task for each subject."""

    def check(self) -> None:
        """Raise UserError unless the options can be used together."""
        for name in ("retries", "row"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise UserError(f"--{name}", expected="0 or more", found=value)
        for one, other in (("row", "slurm"), ("row", "address"), ("slurm", "address")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise UserError(f"--{one}", expected=f"no --{other} beside it", found="both")
