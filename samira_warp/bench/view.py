"""``bench view``: one picture of the viewer, for what a user moves, and its way to the browser."""

from __future__ import annotations

import io
import json as json_format
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from PIL import Image

from samira_warp.avatar import DrivingFrame
from samira_warp.bench import timing
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stopwatch, hardware, print_table
from samira_warp.view.lights import Lights
from samira_warp.view.look import Look
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Scene, Shown, Sides
from samira_warp.view.session import QUICK_QUALITY
from samira_warp.view.state import Lamp, Light, Pose, State

SIZES = (256, 512)

SPLAT_BYTES = 32
"""Of a splat on its way to the browser, before viser compresses them."""

MOVES: dict[str, Callable[[State, int], State]] = {
    "camera": lambda s, k: replace(s, look=_aside(s.look, 0.002 * k)),
    "light": lambda s, k: replace(s, light=replace(s.light, rotate=float(k))),
    "exposure": lambda s, k: replace(s, light=replace(s.light, stops=0.05 * k)),
    "lamp": lambda s, k: replace(s, light=replace(s.light, lamp=Lamp(azimuth=float(k)))),
    "expression": lambda s, k: replace(s, pose=Pose(k)),
}
"""What a user moves, from picture to picture."""


def _aside(look: Look, step: float) -> Look:
    """The look from so many metres farther along the world's x."""
    x, y, z = look.position
    return look._replace(position=(x + step, y, z))


def measure(device: torch.device, *, size: int) -> list[dict[str, object]]:
    """Median milliseconds of a picture of the cpu preset's avatar while something moves, a row for each.

    It has 20,000 Gaussians, under one of the package's lights, with shadows; the viewer keeps what does not
    change. The JPEG file is Pillow's, as viser makes it where there is no OpenCV.
    """
    scene, start = _scene(device, size=size)
    rows = []
    for moved, move in MOVES.items():
        stopwatch, sides = Stopwatch(device), Sides.new()
        for number in range(timing.WARM_UP + timing.REPEATS):
            state = move(start, number)
            with stopwatch.stage("picture"):
                picture = scene.picture(state, sides, width=size, height=size, detail="quick")
            with stopwatch.stage("jpeg"):
                Image.fromarray(picture).save(io.BytesIO(), "JPEG", quality=QUICK_QUALITY)
        times = stopwatch.medians()
        rows.append(
            {
                "size": size,
                "gaussians": len(scene.shown.avatar.gaussians),
                "moves": moved,
                "picture_ms": times["picture"],
                "jpeg_ms": times["jpeg"],
                "pictures_per_second": 1e3 / (times["picture"] + times["jpeg"]),
            }
        )
    return rows


def measure_splats(device: torch.device) -> list[dict[str, object]]:
    """Median milliseconds until splats are ready to be sent to the browser, a row for each that is moved.

    While the camera moves none are sent.
    """
    scene, start = _scene(device, size=SIZES[0])
    rows = []
    for moved, move in MOVES.items():
        if moved == "camera":
            continue
        stopwatch, sides = Stopwatch(device), Sides.new()
        for number in range(timing.WARM_UP + timing.REPEATS):
            with stopwatch.stage("splats"):
                scene.splats(move(start, number), sides.left, detail="quick")
        milliseconds, count = stopwatch.medians()["splats"], len(scene.shown.avatar.gaussians)
        rows.append(
            {
                "splats": count,
                "moves": moved,
                "splats_ms": milliseconds,
                "updates_per_second": 1e3 / milliseconds,
                "megabytes": count * SPLAT_BYTES / 1e6,
            }
        )
    return rows


def _scene(device: torch.device, *, size: int) -> tuple[Scene, State]:
    """The cpu preset's avatar with as many frames as there are pictures, and what is chosen first."""
    avatar, camera = make_avatar("cpu", device=device), make_camera(size)
    frames = [
        DrivingFrame(f"{number:02d}", make_parameters(number), camera, "train")
        for number in range(timing.WARM_UP + timing.REPEATS)
    ]
    scene = Scene(Shown(avatar, Path(), Poser(frames, avatar.canonical.template)), Lights(device=device))
    return scene, State(Look.of(camera), light=Light(next(iter(scene.lights.paths))))


def main(device: str, json: bool) -> None:
    """Measure at every size and print tables, or JSON rows."""
    on = torch.device(device)
    rows = [row for size in SIZES for row in measure(on, size=size)]
    splats = measure_splats(on)
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in (*rows, *splats)]))
        return
    print(hardware(on))
    print_table(rows)
    print_table(splats)
