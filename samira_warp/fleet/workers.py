"""Stages as tasks of Ray, on this machine or on a cluster."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from samira_warp.fleet.manifest import Resources
from samira_warp.fleet.stages import Outcome, Stage, StageCrashError, run_stage
from samira_warp.support.errors import UserError

POLL = 0.5
"""Seconds between looks at what is running."""


class Workers:
    """The machines of a Ray; `open_workers` finds it or starts it."""

    def __init__(self, ray: Any, *, retries: int) -> None:
        self._ray = ray
        self._function, self._retries = ray.remote(run_stage), retries
        self._running: dict[Any, Stage] = {}

    def begin(self, stage: Stage) -> None:
        """Have a stage done as soon as there is room for it."""
        takes = stage.resources
        task = self._function.options(
            max_retries=self._retries,
            retry_exceptions=[StageCrashError],
            name=f"{stage.subject} {stage.name}",
            num_cpus=takes.cores,
            num_gpus=takes.gpus,
            memory=int(takes.memory_gb * 1e9),
        )
        self._running[task.remote(stage)] = stage

    def ended(self) -> list[tuple[Stage, Outcome]]:
        """Stages that have ended since the last call; waits a moment for the first."""
        if not self._running:
            return []
        ready, _ = self._ray.wait(list(self._running), num_returns=len(self._running), timeout=POLL)
        return [(self._running.pop(task), self._outcome(task)) for task in ready]

    def _outcome(self, task: Any) -> Outcome:
        """How a task ended, after all its retries."""
        try:
            return self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:
            cause = error.cause
            return Outcome(False, str(cause) if isinstance(cause, StageCrashError) else repr(cause))
        except self._ray.exceptions.RayError as error:
            return Outcome(False, f"its worker was lost ({type(error).__name__})")

    def __len__(self) -> int:
        """Stages that have not ended."""
        return len(self._running)


@contextlib.contextmanager
def open_workers(address: str | None, needs: Mapping[str, Resources], *, retries: int) -> Iterator[Workers]:
    """Join a cluster, or start a Ray of this machine's own, which ends with the block.

    A Ray that this process has joined already is used as it is, and left.

    Args:
        address: ``auto``, ``HOST:PORT``, or None for this machine alone.
        needs: What the stages take of a machine, by stage.
        retries: How often a stage is tried again.

    Raises:
        UserError: Ray is not installed, the cluster cannot be joined, or this machine is too small.
    """
    ray = _import_ray()
    joined = ray.is_initialized()
    if not joined:
        _join(ray, address)
    try:
        _check_room(ray.nodes(), needs, grows=address is not None)
        yield Workers(ray, retries=retries)
    finally:
        if not joined:
            ray.shutdown()


def _import_ray() -> Any:
    # Ray hides GPUs from tasks that ask for none, says that it will not any more, and is silent with this;
    # stages without a GPU are told to use none (`stages`)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError as error:
        expected = "to be installed (pip install 'samira-warp[fleet]'), or --slurm FILE, which needs none"
        raise UserError("ray", expected=expected, found="no such package") from error
    return ray


def _join(ray: Any, address: str | None) -> None:
    # a driver's local Ray is its own: RAY_ADDRESS in the environment would have it join another
    where: dict[str, Any] = {"address": address or "local"}
    if address is None:
        where["include_dashboard"] = False
    try:
        ray.init(**where, log_to_driver=False, logging_level="warning")
    except Exception as error:  # Ray raises Exception itself where its own processes were too slow
        if address is None:
            expected = "a Ray of this machine's own to start, or --row N, which needs none"
            raise UserError("ray", expected=expected, found=error) from error
        expected = "a Ray cluster, as `ray start --head` begins one"
        raise UserError(f"--address {address}", expected=expected, found=error) from error


def _check_room(nodes: Sequence[Mapping[str, Any]], needs: Mapping[str, Resources], *, grows: bool) -> None:
    """Say where no machine is large enough for a stage, which would wait for ever.

    Args:
        nodes: As Ray tells of them.
        needs: By stage.
        grows: Whether there may be other machines later.

    Raises:
        UserError: None is, and none will be.
    """
    there = [node["Resources"] for node in nodes if node["Alive"]]
    for stage, takes in needs.items():
        asked = {"CPU": takes.cores, "GPU": takes.gpus, "memory": takes.memory_gb * 1e9}
        if any(all(node.get(name, 0.0) >= value for name, value in asked.items()) for node in there):
            continue
        largest = "; ".join(
            f"{node.get('CPU', 0):g} cores, {node.get('GPU', 0):g} GPUs, {node.get('memory', 0) / 1e9:.1f} GB"
            for node in there
        )
        expected = f"a machine with {takes.cores} cores, {takes.gpus:g} GPUs and {takes.memory_gb:g} GB"
        if not grows:
            raise UserError(f"resources.{stage}", expected=expected, found=largest)
        print(f"resources.{stage}: no machine yet with that much: {largest}", file=sys.stderr)
    if not any(takes.gpus for takes in needs.values()) and any(node.get("GPU") for node in there):
        print("there are GPUs, and no stage asks for one ([resources.train] gpus = 1)", file=sys.stderr)
