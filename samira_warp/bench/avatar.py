"""``bench avatar``: one rendered frame, split by stage."""

from __future__ import annotations

import itertools
import json as json_format

import torch

from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stages, hardware, print_table, repeat

SIZES = (256, 512)


@torch.no_grad()
def measure(device: torch.device, *, size: int) -> dict[str, object]:
    """Median milliseconds of a frame of the cpu preset's avatar (20,000 Gaussians): motion, raster and shading, the light filtered once."""
    avatar, camera = make_avatar("cpu", device=device), make_camera(size).to(device)
    light = avatar.light()
    stages = Stages(device)
    frames = itertools.count()

    def frame() -> None:
        parameters = make_parameters(next(frames)).to(device)
        with stages.stage("motion"):
            motion = avatar.move(parameters)
        with stages.stage("raster"):
            gbuffer = avatar.rasterize(motion, camera)
        with stages.stage("shading"):
            avatar.shade(motion, gbuffer, camera, light)

    repeat(frame)
    row = {"size": size, "gaussians": len(avatar.gaussians), **{f"{name}_ms": value for name, value in stages.medians().items()}}
    return {**row, "frames_per_second": 1e3 / row["total_ms"]}


def main(device: str, json: bool) -> None:
    """Measure at every size and print a table, or JSON rows."""
    on = torch.device(device)
    rows = [measure(on, size=size) for size in SIZES]
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table(rows)
