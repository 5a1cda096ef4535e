"""``bench avatar``: one rendered frame, split by stage, for what a user moves."""

from __future__ import annotations

import itertools
import json as json_format
from dataclasses import replace
from typing import NamedTuple

import torch

from samira_warp.avatar import Avatar
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stopwatch, hardware, print_table, repeat
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.light import Environment
from samira_warp.train.config import PresetName

SIZES = (256, 512)
STAGES = ("light", "motion", "occlusion", "raster", "shading", "total")


class Scenario(NamedTuple):
    """What changes from frame to frame, and what therefore stays.

    Attributes:
        moves: What the user moves.
        cached: Results that are made once and used again.
        light: Filter a light each frame, of the learned light's size.
        motion: Pose the head, run the motion network, and trace what the head blocks.
        raster: Rasterise the G-buffer.
        shadows: Let the head block the light.
    """

    moves: str
    cached: str
    light: bool = False
    motion: bool = False
    raster: bool = False
    shadows: bool = True


SCENARIOS = (
    Scenario("everything", "nothing", light=True, motion=True, raster=True),
    Scenario("head", "light", motion=True, raster=True),
    Scenario("camera", "light, motion", raster=True),
    Scenario("light", "motion, G-buffer", light=True),
    Scenario("exposure", "light, motion, G-buffer"),
    Scenario("everything", "nothing", light=True, motion=True, raster=True, shadows=False),
    Scenario("head", "light", motion=True, raster=True, shadows=False),
    Scenario("light", "motion, G-buffer", light=True, shadows=False),
)


@torch.no_grad()
def measure(device: torch.device, *, size: int, preset: PresetName = "cpu") -> list[dict[str, object]]:
    """Median milliseconds of a frame of a preset's avatar, a row for every scenario.

    That of the cpu preset has 20,000 Gaussians; what is cached takes 0. The total is of whole frames, from
    their parameters on.
    """
    avatar, camera = make_avatar(preset, device=device), make_camera(size).to(device)
    rows = []
    for scenario in SCENARIOS:
        stopwatch = Stopwatch(device)
        _frames(scenario, avatar, camera, stopwatch)
        times = stopwatch.medians()
        row = {
            "size": size,
            "gaussians": len(avatar.gaussians),
            "moves": scenario.moves,
            "cached": scenario.cached,
            "shadows": scenario.shadows,
        }
        rows.append(
            {
                **row,
                **{f"{stage}_ms": times.get(stage, 0.0) for stage in STAGES},
                "frames_per_second": 1e3 / times["total"],
            }
        )
    return rows


def _frames(scenario: Scenario, avatar: Avatar, camera: Camera, stopwatch: Stopwatch) -> None:
    """Render frames, timing the stages that the scenario does not take from the first frame."""
    device = camera.world_to_camera.device
    frames = itertools.count()
    learned = avatar.light.environment()
    light = learned.filtered()
    motion = avatar.move(make_parameters(0).to(device))
    gbuffer = avatar.rasterize(motion, camera)
    occlusion = avatar.occluder.occlude(motion.head)

    def frame() -> None:
        number = next(frames)
        parameters, view, environment = (
            make_parameters(number).to(device),
            _turned(camera, number),
            _dimmed(learned, number),
        )
        with stopwatch.stage("total"):
            render(parameters, view, environment, exposure=1.0 + 0.01 * number)

    def render(
        parameters: FrameParameters, view: Camera, environment: Environment, *, exposure: float
    ) -> None:
        nonlocal light, motion, gbuffer, occlusion
        if scenario.light:
            with stopwatch.stage("light"):
                light = environment.filtered()
        if scenario.motion:
            with stopwatch.stage("motion"):
                motion = avatar.move(parameters)
        if scenario.motion and scenario.shadows:
            with stopwatch.stage("occlusion"):
                occlusion = avatar.occluder.occlude(motion.head)
        if scenario.raster:
            with stopwatch.stage("raster"):
                gbuffer = avatar.rasterize(motion, view)
        with stopwatch.stage("shading"):
            shown = view if scenario.raster else camera
            casts = occlusion if scenario.shadows else None
            avatar.shade(motion, gbuffer, shown, light.exposed(exposure), occlusion=casts)

    repeat(frame)


def _turned(camera: Camera, number: int) -> Camera:
    """The camera a little further round the head."""
    angle = torch.tensor(0.02 * number)
    turn = torch.eye(4)
    turn[0, 0] = turn[2, 2] = angle.cos()
    turn[0, 2], turn[2, 0] = angle.sin(), -angle.sin()
    return replace(camera, world_to_camera=camera.world_to_camera @ turn.to(camera.world_to_camera))


def _dimmed(environment: Environment, number: int) -> Environment:
    """A light of other radiance."""
    gain = 1.0 / (1.0 + 0.1 * number)
    return Environment.from_cubemaps(gain * environment.diffuse, gain * environment.specular)


def main(device: str, json: bool) -> None:
    """Measure at every size and print a table, or JSON rows."""
    on = torch.device(device)
    rows = [row for size in SIZES for row in measure(on, size=size)]
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table(rows)
