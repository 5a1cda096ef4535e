"""Times of the rasteriser on a synthetic head: ours on one and two threads, and the plain per-pixel kernels on one as the yardstick."""

from __future__ import annotations

import json as json_format
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from samira_warp.camera import Camera
from samira_warp.kernels.blending import blend
from samira_warp.kernels.projection import Projection, project
from samira_warp.kernels.splats import RECORD
from samira_warp.kernels.tiles import TILE, TileBins, bin_tiles
from samira_warp.reference import blending_plain

GAUSSIANS = (20_000, 50_000, 200_000)
SIZES = (256, 512)
CHANNELS = (3, 9, 11)
REPEATS = 5
PLAIN_BUDGET = 90.0
"""Seconds for the plain kernels in all; scenes after that go without their ratios."""


@dataclass(frozen=True)
class Row:
    """One measurement; the best of REPEATS.

    Attributes:
        gaussians: N.
        size: H = W, pixels.
        channels: C.
        threads: CPU threads; 0 on a GPU.
        intersections: Entries of all tiles.
        prepare_ms: Projection, binning and both sorts.
        forward_ms: Blending.
        backward_ms: Its adjoint.
        forward_ratio: The plain kernel's time on one CPU thread over ours; None where the plain kernel was not run.
        backward_ratio: Likewise.
        pairs_per_second: Pixels of all intersections (256 each) over the forward time.
        cycles_per_16_pairs: Core cycles, all threads together, for 16 of those pairs; None where the clock is unknown.
        peak_bytes: Tensors alive at the end of the backward pass that the operator made: bins, records, images, gradients.
    """

    gaussians: int
    size: int
    channels: int
    threads: int
    intersections: int
    prepare_ms: float
    forward_ms: float
    backward_ms: float
    forward_ratio: float | None
    backward_ratio: float | None
    pairs_per_second: float
    cycles_per_16_pairs: float | None
    peak_bytes: int


@dataclass(frozen=True)
class Scene:
    """N Gaussians in a disc before a camera: the head of the design's section 7, lifted to 3D behind a long lens."""

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    camera: Camera


def make_scene(count: int, size: int, device: torch.device) -> Scene:
    """Uniform in a disc of radius 0.42 H, axes lognormal about 2 px at H = 512 with sigma 0.5, any turn, opacity 0.05..0.95; seed 0."""
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(6, count, generator=generator)
    angle, radius = 2 * math.pi * uniform[0], 0.42 * size * uniform[1].sqrt()
    # a lens this long sees the same ellipse wherever the Gaussian is
    focal = 50.0 * size
    depths = 1.0 + uniform[2]
    means = torch.stack([radius * angle.cos() * depths / focal, radius * angle.sin() * depths / focal, depths], dim=-1)
    pixels = 2.0 * size / 512 * torch.exp(0.5 * torch.randn(count, 2, generator=generator))
    scales = torch.cat([pixels * (depths / focal)[:, None], torch.zeros(count, 1)], dim=-1)
    half_turn = 0.5 * math.pi * uniform[3]
    zero = torch.zeros(count)
    quaternions = torch.stack([half_turn.cos(), zero, zero, half_turn.sin()], dim=-1)
    tensors = (means, quaternions, scales, 0.05 + 0.9 * uniform[4])
    camera = Camera(torch.eye(4), focal, focal, size / 2, size / 2, size, size)
    return Scene(*(tensor.to(device) for tensor in tensors), camera.to(device))


def run(device: torch.device) -> Iterator[Row]:
    """Measure every combination of GAUSSIANS, SIZES and CHANNELS; on a CPU with one and two threads."""
    plain_seconds = 0.0
    threads_before = torch.get_num_threads()
    try:
        for count in GAUSSIANS:
            for size in SIZES:
                scene = make_scene(count, size, device)
                for channels in CHANNELS:
                    start = time.perf_counter()
                    plain = _plain_times(scene, channels) if device.type == "cpu" and plain_seconds < PLAIN_BUDGET else None
                    plain_seconds += time.perf_counter() - start
                    for threads in (1, 2) if device.type == "cpu" else (0,):
                        torch.set_num_threads(threads or threads_before)
                        yield _measure(scene, channels, threads, plain)
    finally:
        torch.set_num_threads(threads_before)


def main(device: str, json: bool) -> None:
    """Print the measurements as a table, or as a JSON list of rows."""
    rows = []
    names = list(Row.__dataclass_fields__)
    if not json:
        print(" ".join(f"{name:>{max(len(name), 8)}}" for name in names))
    for row in run(torch.device(device)):
        rows.append(asdict(row))
        if not json:
            print(" ".join(f"{_text(value):>{max(len(name), 8)}}" for name, value in rows[-1].items()), flush=True)
    if json:
        print(json_format.dumps(rows))


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _inputs(scene: Scene, channels: int) -> tuple[list[Tensor], Projection, TileBins, tuple[Tensor, Tensor]]:
    """What blending takes, and a gradient for each of its results."""
    projection, bins = _prepare(scene)
    generator = torch.Generator().manual_seed(channels)
    features = torch.rand(len(scene.means), channels, generator=generator).to(scene.means)
    size = scene.camera.height
    gradients = tuple(torch.randn(shape, generator=generator).to(scene.means) for shape in ((size, size, channels), (size, size)))
    return [projection.means2d, projection.conics, scene.opacities, features], projection, bins, gradients


def _prepare(scene: Scene) -> tuple[Projection, TileBins]:
    projection = project(scene.means, scene.quaternions, scene.scales, scene.opacities, scene.camera)
    return projection, bin_tiles(projection, scene.opacities, width=scene.camera.width, height=scene.camera.height)


def _plain_times(scene: Scene, channels: int) -> tuple[float, float]:
    """Seconds of the plain kernels, forward and backward, on one thread."""
    torch.set_num_threads(1)
    tensors, _, bins, gradients = _inputs(scene, channels)
    size = {"width": scene.camera.width, "height": scene.camera.height}
    blended = blending_plain.blend(*tensors, bins, **size)
    forward = _best(lambda: blending_plain.blend(*tensors, bins, **size), repeats=2)
    return forward, _best(lambda: blending_plain.blend_adjoint(*tensors, bins, blended, *gradients), repeats=2)


def _measure(scene: Scene, channels: int, threads: int, plain: tuple[float, float] | None) -> Row:
    tensors, projection, bins, gradients = _inputs(scene, channels)
    size = {"width": scene.camera.width, "height": scene.camera.height}
    prepare = _best(lambda: _prepare(scene))
    leaves = [tensor.clone().requires_grad_() for tensor in tensors]
    blended = blend(*leaves, bins, **size)
    forward = _best(lambda: blend(*leaves, bins, **size))
    backward = _best(lambda: torch.autograd.grad(blended, leaves, gradients, retain_graph=True))

    count, intersections = len(scene.means), bins.gaussians.shape[0]
    padded = -(-channels // 8) * 8 + RECORD
    made = [*projection, *bins[:5], *blended, *gradients]
    clock = _clock() if threads else None
    pairs = TILE * TILE * intersections
    return Row(
        gaussians=count,
        size=scene.camera.height,
        channels=channels,
        threads=threads,
        intersections=intersections,
        prepare_ms=1e3 * prepare,
        forward_ms=1e3 * forward,
        backward_ms=1e3 * backward,
        forward_ratio=plain[0] / forward if plain else None,
        backward_ratio=plain[1] / backward if plain else None,
        pairs_per_second=pairs / forward,
        cycles_per_16_pairs=clock * threads * forward / pairs * 16 if clock else None,
        # records of Gaussians, their gradients, and the gradients by slot are all of that width
        peak_bytes=sum(tensor.nbytes for tensor in made) + 4 * padded * (2 * count + intersections),
    )


def _best(function: Callable[[], object], repeats: int = REPEATS) -> float:
    """Least wall time of a call in seconds, after one to warm up; on a GPU the device is waited for."""
    times = []
    for _ in range(1 + repeats):
        start = time.perf_counter()
        function()
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    return min(times[1:])


def _clock() -> float | None:
    """The first core's clock in Hz as the kernel of a Linux machine tells it."""
    information = Path("/proc/cpuinfo")
    found = re.search(r"cpu MHz\s*:\s*([\d.]+)", information.read_text()) if information.is_file() else None
    return 1e6 * float(found[1]) if found else None
