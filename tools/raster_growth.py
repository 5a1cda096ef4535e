"""Measure how the rasteriser's time grows: a table, and a plot.

It grows with Gaussians, pixels, channels and culled Gaussians. The plot is drawn with matplotlib, which the
extra `test` brings.

usage: python tools/raster_growth.py --out FILE.png [--device NAME]
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch

from samira_warp.bench.disc import Disc, make_disc
from samira_warp.bench.raster import StageTimes, stage_times
from samira_warp.bench.timing import hardware
from samira_warp.support.cli import run
from samira_warp.support.constants import ALPHA_MIN
from samira_warp.support.device_names import DeviceName
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRANSLUCENT = 0.1
"""Factor on the disc's opacities, so that pixels see all their Gaussians instead of stopping when they are
full."""

FAINT = 0.5 * ALPHA_MIN
"""The same for Gaussians that are too faint for a pixel of 8 bits."""

STAGES = ("prepare", "forward", "backward")


class Point(NamedTuple):
    """What is measured at once; the defaults are what the other sweeps hold fixed."""

    gaussians: int = 50_000
    culled: int = 0
    size: int = 512
    channels: int = 9


SWEEPS = {
    "gaussians": [Point(gaussians=count) for count in (12_500, 25_000, 50_000, 100_000, 200_000, 400_000)],
    "size": [Point(size=size) for size in (128, 256, 512, 1024, 2048)],
    "channels": [Point(channels=channels) for channels in (1, 2, 4, 8, 16, 32, 64)],
    "culled": [Point(culled=count) for count in (0, 50_000, 100_000, 200_000, 400_000)],
}
"""By the field of `Point` that varies."""

AXES = {
    "gaussians": "Gaussians",
    "size": "image size, pixels",
    "channels": "channels",
    "culled": "culled Gaussians, besides 50,000 that are seen",
}

HEADER = (
    "| varies | Gaussians | culled | size | channels | intersections "
    "| prepare ms | forward ms | backward ms | forward ns/intersection |"
)


@dataclass(frozen=True)
class GrowthConfig:
    """Measure how the rasteriser's time grows with Gaussians, pixels, channels and culled Gaussians."""

    out: Path
    """The .png file to write; the table goes to standard output, as Markdown."""
    device: DeviceName = "auto"
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""


def main(config: GrowthConfig) -> None:
    """Measure, print and plot."""
    if config.out.suffix != ".png":
        raise UserError(
            config.out, expected="a file name ending in .png", found=config.out.suffix or "no suffix"
        )
    if not config.out.parent.is_dir():
        raise UserError(config.out.parent, expected="an existing folder", found="no such folder")
    if importlib.util.find_spec("matplotlib") is None:
        installed = "an installed package, to draw the plot with (pip install -e '.[test]')"
        raise UserError("matplotlib", expected=installed, found="none")
    device = pick_device(config.device)
    measured: dict[str, list[StageTimes]] = {}
    print(f"{hardware(device)}\n")
    print(HEADER)
    print("|---|" + "---:|" * 9)
    for name, points in SWEEPS.items():
        measured[name] = []
        for point, times in _measure(points, device):
            measured[name].append(times)
            milliseconds = " | ".join(f"{getattr(times, stage):.3g}" for stage in STAGES)
            sizes = " | ".join(map(str, point))
            each = f"{_per_intersection(times):.3g}"
            print(f"| {name} | {sizes} | {times.intersections} | {milliseconds} | {each} |")
    _plot(measured, hardware(device)).savefig(config.out, dpi=120)


def _measure(points: list[Point], device: torch.device) -> Iterator[tuple[Point, StageTimes]]:
    for point in points:
        yield point, stage_times(_disc(point, device), point.channels)


def _disc(point: Point, device: torch.device) -> Disc:
    """The benchmark's disc, translucent, with culled Gaussians mixed into it.

    As many are behind the camera as beside the image and as are too faint to see.
    """
    disc = make_disc(point.gaussians + point.culled, point.size, device)
    shuffle = torch.randperm(len(disc.means), generator=torch.Generator().manual_seed(1))
    behind, beside, faint = (chosen.to(device) for chosen in shuffle[: point.culled].tensor_split(3))
    means, opacities = disc.means.clone(), TRANSLUCENT * disc.opacities
    means[behind, 2] *= -1.0
    # the disc ends inside the image: two widths to the side
    means[beside, 0] += 2.0 * point.size / disc.camera.fx * means[beside, 2]
    opacities[faint] *= FAINT / TRANSLUCENT
    return replace(disc, means=means, opacities=opacities)


def _per_intersection(times: StageTimes) -> float:
    """Nanoseconds of blending per intersection."""
    return 1e6 * times.forward / times.intersections


def _plot(measured: dict[str, list[StageTimes]], title: str) -> Figure:
    """One panel per sweep, with what proportional to the intersections would be."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.5), layout="constrained")
    figure.suptitle(title)
    for axes, (name, points) in zip(figure.subplots(2, 2).flat, SWEEPS.items(), strict=True):
        x, times = [getattr(point, name) for point in points], measured[name]
        for stage in STAGES:
            axes.plot(x, [getattr(one, stage) for one in times], marker="o", label=stage)
        if name in ("gaussians", "size"):
            scale = times[-1].forward / times[-1].intersections
            axes.plot(
                x, [scale * one.intersections for one in times], "k:", label="proportional to intersections"
            )
        if name == "culled":
            axes.set_ylim(bottom=0.0)
        else:
            axes.set_xscale("log", base=2)
            axes.set_yscale("log", base=2)
            axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(x, [f"{value:,}" for value in x], rotation=30)
        axes.minorticks_off()
        axes.set_xlabel(AXES[name])
        axes.set_ylabel("milliseconds")
        axes.grid(alpha=0.3)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


if __name__ == "__main__":
    sys.exit(run(main, GrowthConfig, program="python tools/raster_growth.py"))
