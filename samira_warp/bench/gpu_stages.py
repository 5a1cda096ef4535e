"""What the stages of ``bench gpu`` do, each in a process of its own.

``python -m samira_warp.bench.gpu_stages STAGE --device cuda:0`` is one of them: it prints a line of JSON for
every figure, as soon as it is known. All but the tests run on a CPU as well.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from tyro.conf import Positional

from samira_warp.bench import avatar as avatar_bench
from samira_warp.bench import train as train_bench
from samira_warp.bench.disc import make_disc
from samira_warp.bench.gpu import WORKER, tests_folder
from samira_warp.bench.gsplat_peer import gsplat_times
from samira_warp.bench.gswarp_peer import CHANNELS as GSWARP_CHANNELS
from samira_warp.bench.gswarp_peer import gswarp_times
from samira_warp.bench.raster import GBUFFER_CHANNELS, stage_times, whole_times
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stopwatch
from samira_warp.data.subjects import made_subject
from samira_warp.support.cli import run
from samira_warp.support.device_names import DeviceName
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError
from samira_warp.train import TrainConfig, train
from samira_warp.train.config import PresetName
from samira_warp.train.metrics import read_metrics

StageName = Literal[
    "first-use", "raster", "frames", "step", "subject", "training", "gsplat", "gswarp", "tests"
]

PRESET: PresetName = "paper"
"""Whose avatar is drawn and trained."""

GAUSSIANS = 100_000
"""Of the disc that rasterisers draw."""

SIZES = (512, 1024)
"""Width and height of the disc's pictures and the avatar's."""

CHANNELS = (GSWARP_CHANNELS, GBUFFER_CHANNELS)

TRAINING_SECONDS = 60.0
"""A training has as many steps as take this long by themselves."""

ENDING_SECONDS = 15.0
"""What tests that are stopped are given to say how far they came."""

WORKERS = 4
"""Processes of tests at once, where pytest-xdist is installed and there are as many cores."""

NAMED = 5
"""Tests that are named at most where they fail."""

RESULT = "PASSED|FAILED|ERROR|SKIPPED|XFAIL|XPASS"


@dataclass(frozen=True)
class StageConfig:
    """Do what one stage of bench gpu is about."""

    stage: Positional[StageName]
    """Which."""
    device: DeviceName = "cuda"
    """Where to compute."""
    data: Path | None = None
    """training: the dataset; default the built-in subject."""
    seconds: float = 120.0
    """tests: stop after so many seconds."""


def main(config: StageConfig) -> None:
    """Do it, and tell every figure."""
    device = pick_device(config.device)
    if config.stage == "subject":
        subject()
    elif config.stage == "training":
        training(device, config.data)
    elif config.stage == "tests":
        gpu_tests(config.seconds)
    else:
        {
            "first-use": first_use,
            "raster": raster,
            "frames": frames,
            "step": step,
            "gsplat": gsplat,
            "gswarp": gswarp,
        }[config.stage](device)


def tell(what: str, value: float, unit: str) -> None:
    """Print one figure."""
    print(json.dumps([what, value, unit]), flush=True)


def first_use(device: torch.device) -> None:
    """Seconds until the first picture is there, and until a step is done, with what is compiled for them."""
    size = SIZES[0]
    begin = time.perf_counter()
    with torch.no_grad():
        avatar = make_avatar(PRESET, device=device)
        avatar.render(make_parameters(0).to(device), make_camera(size).to(device)).image.cpu()
    tell(f"first picture, {size} x {size}", time.perf_counter() - begin, "s")
    take_step = train_bench.make_step(device, preset=PRESET, shadows=True)
    take_step(Stopwatch(device))
    tell("the picture and the first training step", time.perf_counter() - begin, "s")


def raster(device: torch.device) -> None:
    """The rasteriser on a disc."""
    for size, channels in itertools.product(SIZES, CHANNELS):
        disc, label = make_disc(GAUSSIANS, size, device), _label(size, channels)
        stages, whole = stage_times(disc, channels), whole_times(disc, channels)
        tell(f"prepare, {label}", stages.prepare, "ms")
        tell(f"blend, {label}", stages.forward, "ms")
        tell(f"blend's adjoint, {label}", stages.backward, "ms")
        tell(f"whole operator, {label}", whole.forward, "ms")
        tell(f"whole adjoint, {label}", whole.backward, "ms")


def gsplat(device: torch.device) -> None:
    """The same by gsplat."""
    for size, channels in itertools.product(SIZES, CHANNELS):
        times = gsplat_times(make_disc(GAUSSIANS, size, device), channels)
        if times is None:  # standard error says why
            raise SystemExit(1)
        label = _label(size, channels)
        tell(f"prepare, {label}", times.prepare, "ms")
        tell(f"blend, {label}", times.forward, "ms")
        tell(f"blend's adjoint, {label}", times.backward, "ms")


def gswarp(device: torch.device) -> None:
    """The same by gswarp, which has three channels and is not taken apart."""
    for size in SIZES:
        times = gswarp_times(make_disc(GAUSSIANS, size, device))
        if times is None:
            raise SystemExit(1)
        label = _label(size, GSWARP_CHANNELS)
        tell(f"whole operator, {label}", times.forward, "ms")
        tell(f"whole adjoint, {label}", times.backward, "ms")
        tell(f"difference of the pictures, {label}", times.difference, "of 1")


def _label(size: int, channels: int) -> str:
    return f"{size} x {size}, {channels} channels"


def frames(device: torch.device) -> None:
    """Frames a second of an avatar, by what moves."""
    for size in SIZES:
        for row in avatar_bench.measure(device, size=size, preset=PRESET):
            shadows = "" if row["shadows"] else ", no shadows"
            what = f"{row['moves']} moves, {size} x {size}{shadows}"
            tell(what, _number(row["frames_per_second"]), "frames/s")


def step(device: torch.device) -> None:
    """A training step's milliseconds by stage, and what it launches and waits for."""
    for name, value in train_bench.measure(device, preset=PRESET, shadows=True).items():
        if name.endswith("_ms"):
            tell(f"step, {name.removesuffix('_ms').replace('_', ' ')}", _number(value), "ms")
    counts = train_bench.count(device, preset=PRESET).values()
    tell("Warp launches", sum(found.launches.total() for found in counts), "a step")
    tell("torch operations", sum(found.operations.total() for found in counts), "a step")
    tell("synchronisations", sum(found.waits.total() for found in counts), "a step")
    warned = [found.warned for found in counts if found.warned is not None]
    if warned:
        tell("synchronisations that CUDA tells of", sum(warned), "a step")


def subject() -> None:
    """Make the built-in subject, where it is not there yet."""
    made_subject().dataset()


def training(device: torch.device, data: Path | None) -> None:
    """Train for about a minute, and score. The image encoder is random, which wants no network."""
    milliseconds = _number(train_bench.measure(device, preset=PRESET, shadows=True)["average_ms"])
    steps = max(int(1e3 * TRAINING_SECONDS / milliseconds), 1)
    with tempfile.TemporaryDirectory(prefix="bench-training-") as name:
        run_folder = Path(name) / "run"
        config = TrainConfig(
            data=data or made_subject().dataset(),
            out=run_folder,
            preset=PRESET,
            device=str(device),
            max_steps=steps,
            checkpoint_every=steps,
            encoder="random",
        )
        with contextlib.redirect_stdout(sys.stderr):
            train(config)
        tell("steps", steps, "")
        seconds = read_metrics(run_folder)[-1]["seconds"]
        tell("their time, with decoding and logging", seconds, "s")
        tell("steps a second", steps / seconds, "1/s")
        results = json.loads((run_folder / "results.json").read_text(encoding="utf-8"))
    tell("PSNR of test frames", results["psnr"], "dB")
    tell("SSIM of test frames", results["ssim"], "")


def _number(value: object) -> float:
    assert isinstance(value, (int, float))
    return float(value)


def gpu_tests(seconds: float) -> None:
    """``pytest -m gpu``, and how its tests ended; those that are left when the time is up are not run."""
    command = [sys.executable, "-m", "pytest", "-m", "gpu", "-v", "-rN", "--tb=line", "--color=no"]
    if importlib.util.find_spec("xdist") and (os.cpu_count() or 1) >= WORKERS:
        command += ["-n", str(WORKERS)]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
        process = subprocess.Popen(
            command, cwd=tests_folder().parent, stdout=output, stderr=subprocess.STDOUT
        )
        stopped = not _ends(process, seconds - ENDING_SECONDS)
        if stopped:
            process.send_signal(signal.SIGINT)
            if not _ends(process, 0.5 * ENDING_SECONDS):
                process.kill()
                process.wait()
        output.seek(0)
        text = output.read()
    ended = dict(results_of(text))
    for result, count in sorted(Counter(ended.values()).items()):
        tell(result.lower(), count, "tests")
    bad = [name for name, result in ended.items() if result in ("FAILED", "ERROR")]
    if bad or stopped or process.returncode != 0:
        why = (
            f"time was up after {len(ended)} tests" if stopped else f"pytest's status is {process.returncode}"
        )
        named = bad[:NAMED] + ([f"{len(bad) - NAMED} more"] if len(bad) > NAMED else [])
        raise UserError("pytest -m gpu", expected="all tests to pass", found="; ".join([why, *named]))


def _ends(process: subprocess.Popen[bytes], seconds: float) -> bool:
    """Whether a process ends within so many seconds."""
    try:
        process.wait(timeout=max(seconds, 0.0))
    except subprocess.TimeoutExpired:
        return False
    return True


def results_of(printed: str) -> Iterator[tuple[str, str]]:
    """Tests and their results, of what ``pytest -v`` printed, by one process or by several."""
    for line in printed.splitlines():
        alone = re.match(rf"(\S+::.*?) ({RESULT})\b", line)
        of_worker = re.match(rf"\[gw\d+\] \[ *\d+%\] ({RESULT}) (\S+::.*?) *$", line)
        if alone is not None:
            yield alone[1], alone[2]
        elif of_worker is not None:
            yield of_worker[2], of_worker[1]


if __name__ == "__main__":
    sys.exit(run(main, StageConfig, program=f"python -m {WORKER}"))
