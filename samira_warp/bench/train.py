"""``bench train``: one training step of a preset, split by stage."""

from __future__ import annotations

import json as json_format

import torch

from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stopwatch, hardware, print_table, repeat
from samira_warp.head import FrameParameters
from samira_warp.train.config import PRESETS, PresetName
from samira_warp.train.losses import Known, LossWeights, Target, total_loss
from samira_warp.train.optimizer import make_optimizer, set_rates
from samira_warp.train.tracking import TrackedParameters


def measure(device: torch.device, *, preset: PresetName, shadows: bool) -> dict[str, object]:
    """Median milliseconds of a step in stage two, without LPIPS and without decoding images."""
    size = PRESETS[preset].resolution
    avatar, camera = make_avatar(preset, device=device), make_camera(size).to(device)
    parameters = [make_parameters(seed).to(device) for seed in range(4)]
    tracked = TrackedParameters(FrameParameters.stack(parameters)).to(device)
    optimizer = make_optimizer(avatar, tracked)
    set_rates(optimizer, step=1000, steps=3000)
    grey = torch.full((size, size, 3), 0.5, device=device)
    target = Target(grey, torch.ones(size, size, device=device), grey, torch.ones(3, device=device))
    stopwatch, weights, known = Stopwatch(device), LossWeights(), Known.of(avatar)
    occlusion = avatar.occluder.occlude(avatar.canonical.pose(parameters[0]))

    def step() -> None:
        with stopwatch.stage("light"):
            light = avatar.light()
        with stopwatch.stage("motion"):
            motion = avatar.move(tracked.frame(0, parameters[0]))
        with stopwatch.stage("arrival"):
            arrival = avatar.arrival(occlusion.under(motion.head), light, camera) if shadows else None
        with stopwatch.stage("raster"):
            gbuffer = avatar.rasterize(motion, camera, arrival=arrival)
        with stopwatch.stage("shading"):
            rendering = avatar.shade(motion, gbuffer, camera, light)
        with stopwatch.stage("loss"):
            terms = total_loss(rendering, target, avatar, weights, known, stage_two=True, perceptual=None)
            optimizer.zero_grad(set_to_none=True)
        with stopwatch.stage("backward"):
            torch.stack(list(terms.values())).sum().backward()
        with stopwatch.stage("optimizer"):
            optimizer.step(rows=[0])

    def whole_step() -> None:
        with stopwatch.stage("total"):
            step()

    repeat(whole_step)
    row = {"preset": preset, "size": size, "gaussians": len(avatar.gaussians), "shadows": shadows}
    return {**row, **{f"{name}_ms": value for name, value in stopwatch.medians().items()}}


def main(device: str, json: bool) -> None:
    """Measure the device's preset, with shadows and without, and print a table, or JSON rows."""
    on = torch.device(device)
    preset: PresetName = "paper" if on.type == "cuda" else "cpu"
    rows = [measure(on, preset=preset, shadows=shadows) for shadows in (True, False)]
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table(rows)
