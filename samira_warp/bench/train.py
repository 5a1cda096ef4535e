"""``bench train``: one training step of a preset, split by stage: its time, or what it asks of a GPU."""

from __future__ import annotations

import json as json_format
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

import torch

from samira_warp.bench.counting import Counts, WorkCounter
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.bench.timing import Stopwatch, hardware, print_table, repeat
from samira_warp.head import FrameParameters
from samira_warp.train.config import PRESETS, PresetName
from samira_warp.train.initialize import initial_spread
from samira_warp.train.limits import hold_shapes, longest_axes
from samira_warp.train.losses import Known, LossWeights, Target, total_loss
from samira_warp.train.materials import hold_known
from samira_warp.train.optimizer import make_optimizer, set_rates
from samira_warp.train.schedule import LIGHT_FRAMES
from samira_warp.train.shared_light import SharedLight
from samira_warp.train.tracking import TrackedParameters
from samira_warp.train.unseen import hold_guesses

STEPS_BEFORE = 2
"""Steps before the one whose work is counted: kernels load, and the optimiser makes its state."""

LIGHT = ("light", "light learns")
"""Stages of the step in which the light learns, one of `LIGHT_FRAMES`; the others have none of them."""

MOST = 12
"""Kernels and operations in the table of those that are launched most."""


class Stages(Protocol):
    """What watches a step, stage by stage: a `Stopwatch` or a `WorkCounter`."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """The time that a stage takes."""
        ...


def make_step(device: torch.device, *, preset: PresetName, shadows: bool) -> Callable[[Stages], None]:
    """A step in which the light learns, without LPIPS and without decoding images, to take again and again.

    It is one of stage two.
    """
    size = PRESETS[preset].resolution
    avatar, camera = make_avatar(preset, device=device), make_camera(size).to(device)
    parameters = [make_parameters(seed).to(device) for seed in range(4)]
    tracked = TrackedParameters(FrameParameters.stack(parameters)).to(device)
    optimizer = make_optimizer(avatar, tracked)
    set_rates(optimizer, step=1000, steps=3000)
    grey = torch.full((size, size, 3), 0.5, device=device)
    target = Target(grey, torch.ones(size, size, device=device), grey, torch.ones(3, device=device))
    weights, known = LossWeights(), Known.of(avatar)
    longest = longest_axes(known.face_scales, initial_spread(avatar.canonical, PRESETS[preset].gaussians))
    occlusion = avatar.occluder.occlude(avatar.canonical.pose(parameters[0]))
    shared = SharedLight(avatar.light)

    def step(stages: Stages) -> None:
        with stages.stage("light"):
            light = shared.light()
        with stages.stage("motion"):
            motion = avatar.move(tracked.frame(0, parameters[0]))
        with stages.stage("arrival"):
            arrival = avatar.arrival(occlusion.under(motion.head), light, camera) if shadows else None
        with stages.stage("raster"):
            gbuffer = avatar.rasterize(motion, camera, arrival=arrival)
        with stages.stage("shading"):
            rendering = avatar.shade(motion, gbuffer, camera, light)
        with stages.stage("loss"):
            terms = total_loss(rendering, target, avatar, weights, known, stage_two=True, perceptual=None)
            optimizer.zero_grad(set_to_none=True)
        with stages.stage("backward"):
            torch.stack(list(terms.values())).sum().backward()
        with stages.stage("light learns"):
            shared.listen()
            shared.learn()
        with stages.stage("optimizer"):
            hold_known(avatar.gaussians, known.materials.held)
            hold_guesses(avatar.gaussians)
            optimizer.step(rows=[0])
            hold_shapes(avatar.gaussians, known.face_scales, longest)

    return step


def measure(device: torch.device, *, preset: PresetName, shadows: bool) -> dict[str, object]:
    """Median milliseconds of a step in which the light learns, and what a step takes on average."""
    step, stopwatch = make_step(device, preset=preset, shadows=shadows), Stopwatch(device)

    def whole_step() -> None:
        with stopwatch.stage("total"):
            step(stopwatch)

    repeat(whole_step)
    sizes = PRESETS[preset]
    row = {"preset": preset, "size": sizes.resolution, "gaussians": sizes.gaussians, "shadows": shadows}
    medians = stopwatch.medians()
    medians["average"] = medians["total"] - _rests([medians[name] for name in LIGHT])
    return {**row, **{f"{name.replace(' ', '_')}_ms": value for name, value in medians.items()}}


def _rests(of_the_light: Sequence[float]) -> float:
    """What a step is spared on average of what its light's stages come to."""
    return sum(of_the_light) * (1.0 - 1.0 / LIGHT_FRAMES)


def count(device: torch.device, *, preset: PresetName) -> dict[str, Counts]:
    """What each stage of a step with shadows asks of a GPU."""
    step, stopwatch = make_step(device, preset=preset, shadows=True), Stopwatch(device)
    for _ in range(STEPS_BEFORE):
        step(stopwatch)
    with WorkCounter(device) as counter:
        step(counter)
    return counter.counts


def main(device: str, json: bool, count_work: bool = False) -> None:
    """Measure the device's preset, with shadows and without, and print a table, or JSON rows.

    Args:
        device: Where.
        json: Print JSON.
        count_work: Count launches, operations and waits instead of milliseconds.
    """
    on = torch.device(device)
    preset: PresetName = "paper" if on.type == "cuda" else "cpu"
    if count_work:
        counts = count(on, preset=preset)
        if json:
            print(json_format.dumps([{**row, "hardware": hardware(on)} for row in count_rows(counts)]))
            return
        print(f"{hardware(on)}, preset {preset}")
        print_counts(counts)
        return
    rows = [measure(on, preset=preset, shadows=shadows) for shadows in (True, False)]
    if json:
        print(json_format.dumps([{**row, "hardware": hardware(on)} for row in rows]))
        return
    print(hardware(on))
    print_table(rows)


def count_rows(counts: dict[str, Counts]) -> list[dict[str, object]]:
    """A row for every stage, with its sums and what they are sums of."""
    return [
        {
            "stage": stage,
            "warp_launches": found.launches.total(),
            "torch_operations": found.operations.total(),
            "synchronisations": found.waits.total(),
            "told_by_cuda": found.warned,
            "kernels": dict(found.launches.most_common()),
            "operations": dict(found.operations.most_common()),
            "waits": [{**wait._asdict(), "times": times} for wait, times in found.waits.most_common()],
        }
        for stage, found in counts.items()
    ]


def _number(value: object) -> int:
    assert isinstance(value, int)
    return value


def print_counts(counts: dict[str, Counts]) -> None:
    """Tables of the sums by stage, of every wait, and of what is launched most."""
    sums = ("stage", "warp_launches", "torch_operations", "synchronisations")
    columns = sums if all(found.warned is None for found in counts.values()) else (*sums, "told_by_cuda")
    rows = [{name: row[name] for name in columns} for row in count_rows(counts)]
    totals = {name: sum(_number(row[name]) for row in rows) for name in columns[1:]}
    of_light = [row for row in rows if row["stage"] in LIGHT]
    averages: dict[str, object] = {
        name: total - _rests([_number(row[name]) for row in of_light]) for name, total in totals.items()
    }
    print_table([*rows, {"stage": "total", **totals}, {"stage": "on average", **averages}])
    waits: list[dict[str, object]] = [
        {"stage": stage, "why": wait.why, "by": wait.operation, "where": wait.where, "times": times}
        for stage, found in counts.items()
        for wait, times in found.waits.most_common()
    ]
    if waits:
        print("\nwhat the host waits for on a GPU")
        print_table(waits)
    launched: Counter[tuple[str, str]] = Counter()
    for found in counts.values():
        launched.update({("warp", name): times for name, times in found.launches.items()})
        launched.update({("torch", name): times for name, times in found.operations.items()})
    print("\nlaunched most")
    print_table(
        [{"of": of, "what": what, "times": times} for (of, what), times in launched.most_common(MOST)]
    )
