"""Times of the rasteriser on a synthetic head, beside a yardstick.

That is the plain per-pixel kernels on a CPU, gsplat on a GPU.
"""

from __future__ import annotations

import json as json_format
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

from samira_warp.bench.allocations import peak_bytes
from samira_warp.bench.disc import Disc, RasterInputs, make_disc
from samira_warp.bench.gsplat_peer import GsplatTimes, gsplat_times
from samira_warp.bench.timing import hardware, least_ms
from samira_warp.kernels.plain import blending as blending_plain
from samira_warp.kernels.raster.blending import Blended, blend
from samira_warp.kernels.raster.projection import Projection, project
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.kernels.raster.tiles import TILE, TileBins, bin_tiles
from samira_warp.surface import SURFACE_WIDTH

GBUFFER_CHANNELS = SURFACE_WIDTH + 1
"""Those of the surface, and depth."""

Inputs = TypeVar("Inputs", RasterInputs, "BlendInputs")
"""What the whole operator takes, or blending alone."""

REPEATS = 5
DISPATCH_REPEATS = 100
PLAIN_BUDGET = 240.0
"""Seconds for the plain kernels in all; discs after that go without their ratios."""


class Sweep(NamedTuple):
    """What is measured, in every combination."""

    gaussians: tuple[int, ...]
    sizes: tuple[int, ...]
    channels: tuple[int, ...]
    threads: tuple[int, ...]


SWEEPS = {
    "cpu": Sweep((20_000, 50_000, 200_000), (256, 512), (3, 9, GBUFFER_CHANNELS), (1, 2)),
    "cuda": Sweep((100_000, 500_000), (512, 1024), (3, GBUFFER_CHANNELS), (0,)),
}


@dataclass(frozen=True)
class Row:
    """One measurement: the best of REPEATS on a CPU, their mean between two events on a GPU.

    Attributes:
        gaussians: N.
        size: H = W, pixels.
        channels: C.
        threads: CPU threads; 0 on a GPU.
        intersections: Entries of all tiles.
        prepare_ms: Projection, binning and both sorts.
        forward_ms: Blending.
        backward_ms: Its adjoint.
        plain_forward_ms: The plain kernel on one CPU thread; None where it was not run.
        plain_backward_ms: Likewise.
        forward_ratio: The plain kernel's time over ours.
        backward_ratio: Likewise.
        pairs_per_second: Pixels of all intersections (256 each) over the forward time.
        cycles_per_16_pairs: Core cycles, all threads together, for 16 of those pairs; None where the clock is
            unknown.
        peak_bytes: Most bytes of tensors that the whole operator, with its backward pass, has at once above
            its inputs; measured.
        dispatch_forward_ms: The whole operator on one Gaussian in one tile, where its kernels take
            microseconds: the host's overhead, on a GPU with the wait for the number of intersections.
        dispatch_backward_ms: Likewise.
        gsplat_prepare_ms: See `GsplatTimes`; this and what follows is None where gsplat was not run.
        gsplat_forward_ms: Likewise.
        gsplat_backward_ms: Likewise.
        gsplat_forward_ratio: gsplat's time over ours.
        gsplat_backward_ratio: Likewise.
        hardware: What computed.
    """

    gaussians: int
    size: int
    channels: int
    threads: int
    intersections: int
    prepare_ms: float
    forward_ms: float
    backward_ms: float
    plain_forward_ms: float | None
    plain_backward_ms: float | None
    forward_ratio: float | None
    backward_ratio: float | None
    pairs_per_second: float
    cycles_per_16_pairs: float | None
    peak_bytes: int
    dispatch_forward_ms: float
    dispatch_backward_ms: float
    gsplat_prepare_ms: float | None
    gsplat_forward_ms: float | None
    gsplat_backward_ms: float | None
    gsplat_forward_ratio: float | None
    gsplat_backward_ratio: float | None
    hardware: str


class StageTimes(NamedTuple):
    """Milliseconds of the rasteriser's stages on one disc, and its number of intersections."""

    prepare: float
    forward: float
    backward: float
    intersections: int


class Times(NamedTuple):
    """Milliseconds of a forward and a backward pass."""

    forward: float
    backward: float


def main(device: str, json: bool) -> None:
    """Print the measurements as tables, or as a JSON list of rows."""
    on = torch.device(device)
    if json:
        print(json_format.dumps([asdict(row) for row in run(on, SWEEPS[on.type])]))
        return
    print(hardware(on))
    dispatch: dict[int, tuple[str, str]] = {}
    for row in run(on, SWEEPS[on.type]):
        columns = {name: _text(value) for name, value in asdict(row).items() if _in_table(name, on)}
        if not dispatch:
            print(" ".join(f"{name:>{max(len(name), 8)}}" for name in columns))
        print(" ".join(f"{text:>{max(len(name), 8)}}" for name, text in columns.items()), flush=True)
        dispatch[row.threads] = (_text(row.dispatch_forward_ms), _text(row.dispatch_backward_ms))
    print("\nthreads dispatch_forward_ms dispatch_backward_ms")
    for threads, (forward, backward) in dispatch.items():
        print(f"{threads:>7} {forward:>19} {backward:>20}")


def _in_table(name: str, device: torch.device) -> bool:
    """Whether a field is a column of the large table.

    What is the same in every row is none, nor the other device's yardstick.
    """
    if name.startswith("dispatch") or name == "hardware":
        return False
    if device.type == "cuda":
        return not name.startswith("plain") and name not in (
            "forward_ratio",
            "backward_ratio",
            "cycles_per_16_pairs",
        )
    return not name.startswith("gsplat")


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def run(device: torch.device, sweep: Sweep) -> Iterator[Row]:
    """Measure every combination of a sweep."""
    plain_seconds = 0.0
    dispatch: dict[int, Times] = {}
    threads_before = torch.get_num_threads()
    try:
        for threads in sweep.threads:
            torch.set_num_threads(threads or threads_before)
            dispatch[threads] = dispatch_times(device)
        for count in sweep.gaussians:
            for size in sweep.sizes:
                disc = make_disc(count, size, device)
                for channels in sweep.channels:
                    plain = None
                    if device.type == "cpu" and plain_seconds < PLAIN_BUDGET:
                        torch.set_num_threads(1)
                        start = time.perf_counter()
                        plain = _plain_times(disc, channels)
                        plain_seconds += time.perf_counter() - start
                        if plain_seconds >= PLAIN_BUDGET:
                            print(
                                f"plain kernels left out from here on: they had {PLAIN_BUDGET:g} seconds",
                                file=sys.stderr,
                            )
                    gsplat = gsplat_times(disc, channels) if device.type == "cuda" else None
                    for threads in sweep.threads:
                        torch.set_num_threads(threads or threads_before)
                        yield _row(
                            disc, channels, threads, plain=plain, gsplat=gsplat, dispatch=dispatch[threads]
                        )
    finally:
        torch.set_num_threads(threads_before)


def _row(
    disc: Disc,
    channels: int,
    threads: int,
    *,
    plain: Times | None,
    gsplat: GsplatTimes | None,
    dispatch: Times,
) -> Row:
    ours = stage_times(disc, channels)
    clock = _clock() if threads else None
    pairs_per_second = 1e3 * TILE * TILE * ours.intersections / ours.forward
    return Row(
        gaussians=len(disc.means),
        size=disc.camera.height,
        channels=channels,
        threads=threads,
        intersections=ours.intersections,
        prepare_ms=ours.prepare,
        forward_ms=ours.forward,
        backward_ms=ours.backward,
        plain_forward_ms=plain.forward if plain else None,
        plain_backward_ms=plain.backward if plain else None,
        forward_ratio=plain.forward / ours.forward if plain else None,
        backward_ratio=plain.backward / ours.backward if plain else None,
        pairs_per_second=pairs_per_second,
        cycles_per_16_pairs=16 * clock * threads / pairs_per_second if clock else None,
        peak_bytes=operator_peak_bytes(disc, channels),
        dispatch_forward_ms=dispatch.forward,
        dispatch_backward_ms=dispatch.backward,
        gsplat_prepare_ms=gsplat.prepare if gsplat else None,
        gsplat_forward_ms=gsplat.forward if gsplat else None,
        gsplat_backward_ms=gsplat.backward if gsplat else None,
        gsplat_forward_ratio=gsplat.forward / ours.forward if gsplat else None,
        gsplat_backward_ratio=gsplat.backward / ours.backward if gsplat else None,
        hardware=hardware(disc.means.device),
    )


def stage_times(disc: Disc, channels: int) -> StageTimes:
    """Time preparation, blending and its adjoint, each by itself."""
    projection, bins = _prepare(disc)
    device, grad_image = disc.means.device, disc.image_gradients(channels)
    leaves = _wanting_gradients(_blend_inputs(disc, projection, channels))

    def blended() -> Blended:
        return blend(*leaves, bins, width=disc.camera.width, height=disc.camera.height)

    image = blended()
    return StageTimes(
        prepare=least_ms(lambda: _prepare(disc), device, repeats=REPEATS),
        forward=least_ms(blended, device, repeats=REPEATS),
        backward=least_ms(
            lambda: torch.autograd.grad(image, leaves, grad_image, retain_graph=True),
            device,
            repeats=REPEATS,
        ),
        intersections=bins.records.shape[0],
    )


def dispatch_times(device: torch.device) -> Times:
    """Time the whole operator on one Gaussian in an image of one tile: next to nothing to compute."""
    return whole_times(make_disc(1, TILE, device), 3, repeats=DISPATCH_REPEATS)


def whole_times(disc: Disc, channels: int, *, repeats: int = REPEATS) -> Times:
    """Time the whole operator, with what its backward pass wants, and its adjoint by all five inputs."""
    device = disc.means.device
    leaves, grad_image = _wanting_gradients(disc.raster_inputs(channels)), disc.image_gradients(channels)
    found = rasterize(*leaves, disc.camera)
    return Times(
        least_ms(lambda: rasterize(*leaves, disc.camera), device, repeats=repeats),
        least_ms(
            lambda: torch.autograd.grad((found.features, found.alpha), leaves, grad_image, retain_graph=True),
            device,
            repeats=repeats,
        ),
    )


def operator_peak_bytes(disc: Disc, channels: int) -> int:
    """Peak bytes of the whole operator, there and back, above its inputs and the gradients it gets."""
    leaves, grad_image = _wanting_gradients(disc.raster_inputs(channels)), disc.image_gradients(channels)

    def there_and_back() -> None:
        found = rasterize(*leaves, disc.camera)
        torch.autograd.grad((found.features, found.alpha), leaves, grad_image)

    return peak_bytes(there_and_back, disc.means.device)


def _plain_times(disc: Disc, channels: int) -> Times:
    projection, bins = _prepare(disc)
    inputs, device = _blend_inputs(disc, projection, channels), disc.means.device
    grad_features, grad_transmittance = disc.image_gradients(channels)
    gaussians = bins.gaussians

    def blended() -> Blended:
        return blending_plain.blend(
            *inputs, bins, gaussians, width=disc.camera.width, height=disc.camera.height
        )

    image = blended()
    return Times(
        least_ms(blended, device, repeats=REPEATS),
        least_ms(
            lambda: blending_plain.blend_adjoint(
                *inputs, bins, gaussians, image, grad_features, grad_transmittance
            ),
            device,
            repeats=REPEATS,
        ),
    )


class BlendInputs(NamedTuple):
    """What `blend` takes: see there."""

    means2d: Tensor
    conics: Tensor
    opacities: Tensor
    features: Tensor


def _prepare(disc: Disc) -> tuple[Projection, TileBins]:
    projection = project(disc.means, disc.quaternions, disc.scales, disc.opacities, disc.camera)
    bins = bin_tiles(projection, width=disc.camera.width, height=disc.camera.height)
    return projection, bins


def _blend_inputs(disc: Disc, projection: Projection, channels: int) -> BlendInputs:
    return BlendInputs(projection.means2d, projection.conics, projection.opacities, disc.features(channels))


def _wanting_gradients(inputs: Inputs) -> Inputs:
    """Copies of tensors that want gradients."""
    return type(inputs)(*(tensor.clone().requires_grad_() for tensor in inputs))


def _clock() -> float | None:
    """The first core's clock in Hz as the kernel of a Linux machine tells it."""
    information = Path("/proc/cpuinfo")
    found = re.search(r"cpu MHz\s*:\s*([\d.]+)", information.read_text()) if information.is_file() else None
    return 1e6 * float(found[1]) if found else None
