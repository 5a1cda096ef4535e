"""``bench memory``: what a training on a dataset takes of memory, stage by stage."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from samira_warp.bench.resident import forget_peak, resident
from samira_warp.bench.timing import hardware, print_table
from samira_warp.check.opening import open_checked
from samira_warp.data import PixelCache, TrackedSequence, made_subject
from samira_warp.evaluate import Lpips
from samira_warp.train.config import TrainConfig
from samira_warp.train.perceptual import PerceptualDistances
from samira_warp.train.plan import TrainPlan, make_plan
from samira_warp.train.results import score, write_result
from samira_warp.train.settings import resolve
from samira_warp.train.setup import PIXEL_CACHE_BYTES, start
from samira_warp.train.trainer import Trainer

STEPS = 40
"""Length of the run whose schedule is followed: Gaussians grow to their most, and what no picture saw is
guessed."""

LAST_STEPS = 4
"""Steps that are taken once all frames are kept."""

SCORED = 8
"""Test frames that are scored: each takes what any other does."""

MEGABYTE = 1e6


@dataclass(frozen=True)
class Row:
    """One stage.

    Attributes:
        stage: Which.
        peak_bytes: Most that the process had in memory during the stage.
        after_bytes: What it had at its end.
        frames_bytes: Of that, decoded frames that are kept.
        traced_bytes: Of that, what is kept of traced frames; on a GPU it lies there.
        gaussians: How many there were at its end.
        gpu_peak_bytes: Most bytes of torch's tensors on the GPU during the stage, None on a CPU.
    """

    stage: str
    peak_bytes: int
    after_bytes: int
    frames_bytes: int
    traced_bytes: int
    gaussians: int
    gpu_peak_bytes: int | None


class Record:
    """Rows of the stages that have passed.

    Attributes:
        rows: In their order.
        pixels: The frames that are kept, from where on there are any.
        trainer: Likewise.
    """

    def __init__(self, device: torch.device) -> None:
        """Begin with the stage that ends here: all that was imported."""
        self.rows: list[Row] = []
        self.pixels: PixelCache | None = None
        self.trainer: Trainer | None = None
        self._device = device
        self._end("imports")

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Have a row for what is inside."""
        forget_peak()
        if self._device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(self._device)
        yield
        self._end(name)

    def _end(self, name: str) -> None:
        memory, trainer = resident(), self.trainer
        on_gpu = self._device.type == "cuda"
        row = Row(
            stage=name,
            peak_bytes=memory.peak,
            after_bytes=memory.now,
            frames_bytes=0 if self.pixels is None else self.pixels.kept_bytes,
            traced_bytes=0 if trainer is None else trainer.occlusions.kept_bytes,
            gaussians=0 if trainer is None else len(trainer.avatar.gaussians),
            gpu_peak_bytes=torch.cuda.max_memory_allocated(self._device) if on_gpu else None,
        )
        self.rows.append(row)


def measure(device: torch.device, data: Path) -> list[Row]:
    """A short training on a dataset, with the device's preset and as many frames kept as in a long one.

    It is the same as a run of the train verb but for its log. Kernels should have been compiled before, as
    they are after one run.

    Args:
        device: Where to train.
        data: The dataset's folder.

    Raises:
        UserError: The dataset cannot be trained on, or the system does not tell what a process takes.
    """
    record = Record(device)
    with TemporaryDirectory() as folder:
        config = TrainConfig(data=data, max_steps=STEPS)
        settings = replace(resolve(config, data=data, out=Path(folder)), device=str(device))
        with record.stage("dataset opened"):
            sequence = open_checked(settings.data, split=settings.split)
        plan = make_plan(settings, sequence, config)
        with PixelCache(
            sequence.frames,
            resolution=settings.resolution,
            max_bytes=PIXEL_CACHE_BYTES,
            pinned=device.type == "cuda",
        ) as pixels:
            record.pixels = pixels
            _train(record, plan, sequence, pixels)
    return record.rows


def _train(record: Record, plan: TrainPlan, sequence: TrackedSequence, pixels: PixelCache) -> None:
    """From the avatar to its scores."""
    distances = PerceptualDistances.find(plan.settings.preset, None).at_sizes(plan)
    with record.stage("avatar made"):
        trainer = Trainer(plan, sequence, pixels, start(plan, sequence, pixels).avatar)
        if isinstance(distances.training, Lpips):
            trainer.perceptual = distances.training.to(trainer.device)
    record.trainer = trainer
    first, until = plan.schedule.density
    steps = plan.schedule.steps
    with record.stage("first step"):
        trainer.train_step()
    with record.stage("steps"):
        _steps(trainer, until=round(first * steps))
    with record.stage("Gaussians added"):
        _steps(trainer, until=round(until * steps))
    with record.stage("unseen guessed"):
        _steps(trainer, until=steps - LAST_STEPS)
    with record.stage("all frames kept"):
        _keep_all(trainer)
    with record.stage("steps after it"):
        _steps(trainer, until=steps)
    with record.stage("saved"):
        trainer.save(plan.settings.out, {})
        write_result(plan.settings.out, trainer, {})
    with record.stage("scored"):
        few = replace(sequence, test=sequence.test[:SCORED])
        score(trainer.avatar, few, pixels, plan=plan, distances=distances)


def _steps(trainer: Trainer, *, until: int) -> None:
    while trainer.step < until:
        trainer.train_step()


@torch.no_grad()
def _keep_all(trainer: Trainer) -> None:
    """Show every frame once, or as many as are kept: decoded, and where it trains traced."""
    sequence, pixels, occlusions = trainer.sequence, trainer.pixels, trainer.occlusions
    for index in (*sequence.train, *sequence.test):
        if pixels.full:
            break
        pixels[index]
    for row, index in enumerate(sequence.train):
        if occlusions.full or not trainer.avatar.settings.visibility:
            break
        parameters = trainer.tracked.frame(row, sequence.frames[index].parameters)
        occlusions.of(row, parameters, trainer.avatar.canonical.pose(parameters))


def main(device: str, json: bool, data: Path | None) -> None:
    """Measure a dataset, else the built-in subject's, and print a table in megabytes, or JSON rows."""
    on = torch.device(device)
    rows = measure(on, made_subject().dataset() if data is None else data)
    if json:
        print(json_format.dumps([{**asdict(row), "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table([_in_megabytes(row) for row in rows])


def _in_megabytes(row: Row) -> dict[str, object]:
    cells = {name: value for name, value in asdict(row).items() if value is not None}
    return {
        name.replace("bytes", "mb"): round(value / MEGABYTE) if name.endswith("bytes") else value
        for name, value in cells.items()
    }
