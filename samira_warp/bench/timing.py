"""Timing by stages, on either device."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

REPEATS = 15
"""Timed runs; their median is reported."""

WARM_UP = 3
"""Untimed runs before: kernels load and caches fill."""


class Stopwatch:
    """Milliseconds of named stages, over many runs."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._samples: dict[str, list[float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is inside, other stages included; on a GPU, from an idle device to an idle device."""
        self._wait()
        begin = time.perf_counter()
        yield
        self._wait()
        self._samples.setdefault(name, []).append(1e3 * (time.perf_counter() - begin))

    def medians(self) -> dict[str, float]:
        """Median milliseconds of every stage, without the warm-up runs."""
        return {name: statistics.median(samples[WARM_UP:]) for name, samples in self._samples.items()}

    def _wait(self) -> None:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)


def repeat(run: Callable[[], object]) -> None:
    """Run often enough for `Stopwatch.medians`."""
    for _ in range(WARM_UP + REPEATS):
        run()


def least_ms(function: Callable[[], object], device: torch.device, *, repeats: int) -> float:
    """Milliseconds of a call, after one to warm up.

    On a CPU it is the least of ``repeats``, on a GPU their mean between two events.
    """
    function()
    if device.type == "cuda":
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        for _ in range(repeats):
            function()
        end.record()
        end.synchronize()
        return begin.elapsed_time(end) / repeats
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return min(times)


def hardware(device: torch.device) -> str:
    """What computes: the GPU's name, or the CPU's with the number of threads."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{_processor()}, {torch.get_num_threads()} threads"


def _processor() -> str:
    """The processor's name as Linux tells it, else what Python knows."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def print_table(rows: list[dict[str, object]]) -> None:
    """Print rows with equal keys as aligned columns."""
    cells = [[str(key) for key in rows[0]]]
    cells += [
        [f"{value:.1f}" if isinstance(value, float) else str(value) for value in row.values()] for row in rows
    ]
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
