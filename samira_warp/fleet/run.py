"""A fleet from its manifest to its table."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from samira_warp.fleet.config import FleetConfig
from samira_warp.fleet.manifest import Manifest, read_manifest
from samira_warp.fleet.results import TABLE_FILE, markdown, write_results
from samira_warp.fleet.slurm import job_script
from samira_warp.fleet.stages import Stage, StageCrashError, mark_lost, run_stage, stages_of
from samira_warp.fleet.watch import Watch, open_watch
from samira_warp.fleet.workers import Workers, open_workers
from samira_warp.io.alone import alone
from samira_warp.io.files import check_writable, replace_file
from samira_warp.support.errors import UserError


def fleet(config: FleetConfig) -> None:
    """Do what a manifest lists, keep what is done, and write and print the table.

    Raises:
        UserError: An option or the manifest cannot be used, or some subjects failed: the others are finished
            first.
    """
    config.check()
    path, out = config.manifest.absolute(), config.out.absolute()
    manifest = read_manifest(path)
    rows = [stages_of(subject, manifest, out) for subject in manifest.subjects]
    check_writable(out)
    out.mkdir(parents=True, exist_ok=True)
    if config.slurm is not None:
        _write_job(config, manifest, path, out, rows)
        return
    if config.row is not None:
        if config.row >= len(rows):
            raise UserError("--row", expected=f"0 to {len(rows) - 1}, of the manifest", found=config.row)
        _do_here(rows[config.row], config.retries)
        results = [write_results(rows, out)[config.row]]
    else:
        with alone(out, what="these subjects"):
            _do_all(rows, manifest, config)
            results = write_results(rows, out)
        print(markdown(results), end="")
    failed = [result for result in results if result.state != "done"]
    if failed:
        first = failed[0]
        expected = f"all {len(results)} subjects to be done" if len(results) > 1 else "the subject to be done"
        found = f"{len(failed)} failed, the first is {first.subject} ({first.stage}: {first.why})"
        raise UserError(out / TABLE_FILE, expected=expected, found=found)


def _write_job(
    config: FleetConfig, manifest: Manifest, path: Path, out: Path, rows: Sequence[Sequence[Stage]]
) -> None:
    if config.slurm is not None:
        script = job_script(manifest, path, out, stages=_names(rows), retries=config.retries)
        replace_file(config.slurm, script)
        print(f"sbatch {config.slurm} does {len(rows)} subjects", file=sys.stderr)


def _names(rows: Sequence[Sequence[Stage]]) -> list[str]:
    """Names of the stages that there are, in their order."""
    return list(
        dict.fromkeys(stage.name for stages in sorted(rows, key=len, reverse=True) for stage in stages)
    )


def _do_here(stages: Sequence[Stage], retries: int) -> None:
    """Do the stages of one subject in this process, until one fails."""
    for stage in stages:
        for left in range(retries, -1, -1):
            try:
                if not run_stage(stage).done:
                    return
                break
            except StageCrashError as crash:
                print(f"{stage.subject}: {stage.name} {crash}; {left} tries left", file=sys.stderr)
        else:
            return


def _do_all(rows: Sequence[Sequence[Stage]], manifest: Manifest, config: FleetConfig) -> None:
    """Do what is not done of all subjects, a stage of each at a time."""
    left: dict[str, list[Stage]] = {}
    with open_watch(rows) as watch:
        for stages in rows:
            first = next((number for number, stage in enumerate(stages) if not stage.done), len(stages))
            watch.keep(stages[:first])
            if first < len(stages):
                left[stages[0].subject] = list(stages[first:])
        if not left:
            return
        needs = {name: manifest.resources[name] for name in _names(list(left.values()))}
        with open_workers(config.address, needs, retries=config.retries) as workers:
            for stages in left.values():
                _begin(stages, workers, watch)
            while len(workers):
                for stage, outcome in workers.ended():
                    watch.end(stage, outcome)
                    if outcome.done:
                        _begin(left[stage.subject], workers, watch)
                    else:
                        mark_lost(stage, outcome.why)
                watch.show()


def _begin(stages: list[Stage], workers: Workers, watch: Watch) -> None:
    """Have the next stage of a subject done, if there is one."""
    if stages:
        stage = stages.pop(0)
        watch.begin(stage)
        workers.begin(stage)
