"""``bench gpu``: all that wants a GPU to be measured or tested, in eight minutes and one table.

Every stage is a process of its own, with a time limit: one that fails, hangs or loses the GPU takes nothing
along, and what it told by then is kept. Kernels are compiled into a cache of this run's own, which is empty
at first.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json as json_format
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
import warp as wp

from samira_warp.bench.timing import hardware
from samira_warp.support.device_names import DeviceName
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError

SECONDS = 470.0
"""All stages together: eight minutes, less what starts and ends around them."""

LEAST_SECONDS = 5.0
"""Less than this is not worth beginning a stage with."""

NEEDS = "an NVIDIA GPU that torch and Warp can use: its driver, and a torch that is built for CUDA"

WORKER = "samira_warp.bench.gpu_stages"
"""The module that does what a stage is about."""

LIMITS = {
    "first use": 120.0,
    "second use": 30.0,
    "raster": 40.0,
    "frames": 60.0,
    "step": 40.0,
    "gswarp": 60.0,
    "subject": 150.0,
    "training": 130.0,
    "gsplat": 120.0,
    "tests": SECONDS,
}
"""Seconds that each stage may take, in their order. The last one has what the others leave."""

OURS = "raster"
"""The stage whose figures those of other rasterisers are divided by, where they are of the same thing."""


class Stage(NamedTuple):
    """One part of the table.

    Attributes:
        name: Its name there.
        seconds: At most; it ends where the whole time does, too.
        words: From its seconds to its command, which prints rows on standard output, each one line of JSON: a
            list of what, value and unit. Nonzero is failure, and the last line on standard error says why.
        lacks: Why it is left out; None where it is not.
    """

    name: str
    seconds: float
    words: Callable[[float], Sequence[str]]
    lacks: str | None = None


class Row(NamedTuple):
    """A figure.

    Attributes:
        what: Of what.
        value: The number.
        unit: Its unit.
    """

    what: str
    value: float
    unit: str


class Outcome(NamedTuple):
    """What came of a stage.

    Attributes:
        name: Its name.
        seconds: What it took.
        rows: What it told, all or until it failed.
        remark: Why it failed or was left out; empty where it did not and was not.
        failed: Whether it failed.
    """

    name: str
    seconds: float
    rows: list[Row]
    remark: str
    failed: bool


def pick_gpu(name: DeviceName) -> torch.device:
    """The GPU that ``--device`` names, or torch's current one.

    Raises:
        UserError: There is none that torch and Warp can use.
    """
    if name == "cpu":
        raise UserError("bench gpu", expected=NEEDS, found="--device cpu")
    if not torch.cuda.is_available():
        without = torch.version.cuda is None
        found = f"torch {torch.__version__}, {'built without CUDA' if without else 'which sees no GPU'}"
        raise UserError("bench gpu", expected=NEEDS, found=found)
    return pick_device("cuda" if name == "auto" else name)


def main(device: str, json: bool, data: Path | None) -> None:
    """Run all stages and print the table, or a JSON object; status 1 where one failed."""
    if data is not None and not data.is_dir():
        raise UserError("--data", expected="a dataset's folder", found=data)
    with tempfile.TemporaryDirectory(prefix="bench-gpu-") as name:
        outcomes = list(run_stages(stages_of(device, data), Path(name), seconds=SECONDS))
    print_outcomes(outcomes, machine(torch.device(device)), json=json)
    if any(outcome.failed for outcome in outcomes):
        raise SystemExit(1)


def machine(device: torch.device) -> str:
    """What computes, and by which libraries."""
    libraries = f"torch {torch.__version__}, Warp {wp.__version__}, Python {platform.python_version()}"
    return f"{hardware(device)}, {os.cpu_count()} CPU cores, {libraries}"


def stages_of(device: str, data: Path | None) -> list[Stage]:
    """All stages, those that lack something marked."""
    options = ["--device", device, *([] if data is None else ["--data", str(data)])]

    def command(name: str) -> Callable[[float], list[str]]:
        task = name.replace("second use", "first use").replace(" ", "-")
        return lambda seconds: [sys.executable, "-m", WORKER, task, *options, "--seconds", f"{seconds:.0f}"]

    lacks = {
        "gsplat": _absent("gsplat"),
        "gswarp": _absent("gswarp"),
        "subject": None if data is None else "--data names another",
        "tests": _absent("pytest") or _no_tests(),
    }
    return [Stage(name, limit, command(name), lacks.get(name)) for name, limit in LIMITS.items()]


def _absent(module: str) -> str | None:
    return None if importlib.util.find_spec(module) else f"{module} is not installed"


def _no_tests() -> str | None:
    return None if (tests_folder() / "conftest.py").is_file() else f"no tests in {tests_folder()}"


def tests_folder() -> Path:
    """Where a checkout has the tests of this package."""
    return Path(__file__).resolve().parents[2] / "tests"


def run_stages(stages: Sequence[Stage], folder: Path, *, seconds: float) -> Iterator[Outcome]:
    """Run stages one after the other, and say on standard error which one is at work.

    Args:
        stages: In their order.
        folder: For caches and what stages print; empty.
        seconds: For all of them; those that are left when it is over fail for want of time.
    """
    end = time.monotonic() + seconds
    caches = {"WARP_CACHE_PATH": str(folder / "warp"), "CUDA_CACHE_PATH": str(folder / "cuda")}
    for stage in stages:
        left = min(stage.seconds, end - time.monotonic())
        if stage.lacks is not None:
            yield Outcome(stage.name, 0.0, [], f"left out: {stage.lacks}", failed=False)
        elif left < LEAST_SECONDS:
            yield Outcome(stage.name, 0.0, [], "failed: no time was left", failed=True)
        else:
            print(f"{stage.name}: at most {left:.0f} s", file=sys.stderr, flush=True)
            yield _run(stage, left, folder, os.environ | caches)


def _run(stage: Stage, seconds: float, folder: Path, environment: dict[str, str]) -> Outcome:
    """One stage in a process group of its own, which is ended where its time is over."""
    printed, said = folder / f"{stage.name}.out", folder / f"{stage.name}.err"
    begin = time.monotonic()
    with printed.open("wb") as output, said.open("wb") as errors:
        process = subprocess.Popen(
            [*stage.words(seconds)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=errors,
            env=environment,
            start_new_session=True,
        )
        try:
            status: int | None = process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            # with all that it has started
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    took = time.monotonic() - begin
    rows = list(_rows(printed.read_text(encoding="utf-8", errors="replace")))
    if status == 0:
        return Outcome(stage.name, took, rows, "", failed=False)
    why = f"time was up after {seconds:.0f} s" if status is None else _reason(said, status)
    return Outcome(stage.name, took, rows, f"failed: {why}", failed=True)


def _rows(printed: str) -> Iterator[Row]:
    """The lines that are rows; libraries may print what they like beside them."""
    for line in printed.splitlines():
        with contextlib.suppress(ValueError, TypeError):
            what, value, unit = json_format.loads(line)
            yield Row(str(what), float(value), str(unit))


def _reason(said: Path, status: int) -> str:
    """The last line on standard error, or how the process ended."""
    lines = said.read_text(encoding="utf-8", errors="replace").replace("\r", "\n").splitlines()
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    ended = f"ended by signal {-status}" if status < 0 else f"status {status}"
    return last.removeprefix("error: ") or ended


def print_outcomes(outcomes: Sequence[Outcome], machine: str, *, json: bool) -> None:
    """One Markdown table, or a JSON object."""
    ours = {
        row.what: row.value
        for outcome in outcomes
        if outcome.name == OURS
        for row in outcome.rows
        if row.value
    }
    if json:
        told = [
            {**outcome._asdict(), "rows": [_with_ratio(row, outcome, ours) for row in outcome.rows]}
            for outcome in outcomes
        ]
        print(json_format.dumps({"machine": machine, "stages": told}))
        return
    print(f"{machine}\n\n| stage | what | found | unit | over ours | remark |\n|---|---|---:|---|---:|---|")
    for outcome in outcomes:
        took = f"{outcome.seconds:.1f}" if outcome.seconds else ""
        print(f"| **{outcome.name}** | all of it | {took} | s | | {outcome.remark.replace('|', '/')} |")
        for row in outcome.rows:
            ratio = _with_ratio(row, outcome, ours)["over_ours"]
            over = "" if ratio is None else f"{ratio:.2f}"
            print(f"| | {row.what} | {row.value:.4g} | {row.unit} | {over} | |")


def _with_ratio(row: Row, outcome: Outcome, ours: dict[str, float]) -> dict[str, object]:
    """A row with what it is over ours of the same thing, which most have none of."""
    comparable = outcome.name != OURS and row.what in ours
    return {**row._asdict(), "over_ours": row.value / ours[row.what] if comparable else None}
