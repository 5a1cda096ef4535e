"""A fleet as a job of SLURM: an array with a task for each subject, which needs no Ray."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path

from samira_warp.fleet.manifest import Manifest, Resources


def job_script(manifest: Manifest, path: Path, out: Path, *, stages: list[str], retries: int) -> str:
    """What ``sbatch`` takes.

    A task does all stages of its subject, and is given what the largest of them takes. Where a job is
    preempted it is queued again, and goes on.

    Args:
        manifest: What is to be done.
        path: Its file.
        out: The fleet's folder.
        stages: Names of those that there are.
        retries: How often a stage is tried again.
    """
    needs = [manifest.resources[name] for name in stages]
    most = Resources(
        cores=max(each.cores for each in needs),
        gpus=max(each.gpus for each in needs),
        memory_gb=max(each.memory_gb for each in needs),
    )
    verb = [
        sys.executable,
        "-m",
        "samira_warp.fleet",
        str(path),
        "--out",
        str(out),
        "--retries",
        str(retries),
    ]
    lines = [
        "#!/bin/bash",
        f"#SBATCH --job-name={path.stem.replace(' ', '_')}",
        f"#SBATCH --array=0-{len(manifest.subjects) - 1}",
        f"#SBATCH --cpus-per-task={most.cores}",
        f"#SBATCH --mem={math.ceil(most.memory_gb * 1e3)}M",
        *([f"#SBATCH --gres=gpu:{math.ceil(most.gpus)}"] if most.gpus else []),
        f"#SBATCH --output={out}/slurm-%A_%a.log",
        "#SBATCH --requeue",
        "#SBATCH --open-mode=append",
        f'exec {shlex.join(verb)} --row "$SLURM_ARRAY_TASK_ID"',
    ]
    return "\n".join([*lines, ""])
