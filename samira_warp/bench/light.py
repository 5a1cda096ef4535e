"""``python -m samira_warp.bench light``: time and error of filtering, lookup and shading."""

from __future__ import annotations

import json as json_module
import statistics
import time
from collections.abc import Callable

import torch

from samira_warp.kernels.cubemap_filter import irradiance, prefilter
from samira_warp.light.environment import Environment
from samira_warp.light.equirect import equirect_to_cube
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.learnable import LearnableLight
from samira_warp.light.shading import shade
from samira_warp.reference import filtering as reference

SHADED_PIXELS = 65536
"""A frame of 256 x 256, every pixel covered."""

BRUTE_FORCE_LADDER = ((0.25, 16), (0.5, 8), (1.0, 8))
"""Roughness and size at which filters are compared with float64 sums over all pairs of texels."""


def main(device: str, json: bool) -> None:
    """Measure on ``device`` and print a table, or with ``json`` one object.

    Its fields: ``furnace_max_error``, over all mips and the irradiance of a uniform light of 1; ``bruteforce_max_error``, over one-hot and
    random maps, by the peak; ``step_ms``, a training step's filtering, forward and adjoint; ``shade_ms`` and ``shade_adjoint_ms``, of
    65,536 pixels under the learned light; ``environment_ms``, a panorama of 1024 x 512 in memory to a filtered environment of 256.
    """
    place = torch.device(device)
    row = {
        "device": device,
        "threads": torch.get_num_threads(),
        "furnace_max_error": _furnace_error(place),
        "bruteforce_max_error": _brute_force_error(place),
        "step_ms": _step_ms(place),
        **_shade_ms(place),
        "environment_ms": _environment_ms(place),
    }
    if json:
        print(json_module.dumps(row))
        return
    for name, value in row.items():
        print(f"{name:22} {value:.3g}" if isinstance(value, float) else f"{name:22} {value}")


def _furnace_error(device: torch.device) -> float:
    white = torch.ones(6, 64, 64, 1, device=device)
    light = FilteredLight.of(white[:, :16, :16], white)
    return max((mip - 1).abs().max().item() for mip in (light.irradiance, *light.specular))


def _brute_force_error(device: torch.device) -> float:
    generator = torch.Generator().manual_seed(0)
    one_hot = torch.zeros(6, 32, 32, 1, dtype=torch.float64)
    one_hot[4, 3, 17] = 1.0
    worst = 0.0
    for base in (one_hot, torch.rand(6, 32, 32, 1, generator=generator, dtype=torch.float64)):
        single = base.float().to(device)
        exact = (reference.irradiance(base), *reference.prefilter(base, ladder=BRUTE_FORCE_LADDER)[1:])
        ours = (irradiance(single), *prefilter(single, ladder=BRUTE_FORCE_LADDER)[1:])
        worst = max(worst, *(((a.cpu() - b).abs().max() / b.max()).item() for a, b in zip(ours, exact, strict=True)))
    return worst


def _step_ms(device: torch.device) -> float:
    light = LearnableLight(torch.ones(3)).to(device)
    upstream = [torch.ones_like(mip) for mip in _maps(light())]

    def step() -> None:
        torch.autograd.grad(_maps(light()), list(light.parameters()), upstream)

    return _median_ms(step, device, repeats=11)


def _shade_ms(device: torch.device) -> dict[str, float]:
    generator = torch.Generator().manual_seed(0)

    def random(channels: int) -> torch.Tensor:
        return torch.rand(SHADED_PIXELS, channels, generator=generator)

    normal = torch.nn.functional.normalize(random(3) * 2 - 1, dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * (random(3) * 2 - 1), dim=-1).to(device)
    values = [value.to(device).requires_grad_() for value in (random(3), normal, random(1), random(1), random(1), random(1))]
    light = LearnableLight(torch.ones(3)).to(device)()
    maps = [mip.detach().requires_grad_() for mip in _maps(light)]
    light = FilteredLight(maps[0], tuple(maps[1:]))
    color = shade(*values, view, light).color
    upstream = torch.ones_like(color)
    return {
        "shade_ms": _median_ms(lambda: shade(*values, view, light), device, repeats=11),
        "shade_adjoint_ms": _median_ms(
            lambda: torch.autograd.grad(color, [*values, *maps], upstream, retain_graph=True), device, repeats=11
        ),
    }


def _environment_ms(device: torch.device) -> float:
    generator = torch.Generator().manual_seed(0)
    panorama = torch.rand(512, 1024, 3, generator=generator).to(device)

    def load() -> None:
        radiance = equirect_to_cube(panorama, size=256)
        Environment(radiance, radiance).filtered()

    return _median_ms(load, device, repeats=3)


def _maps(light: FilteredLight) -> list[torch.Tensor]:
    """Irradiance and the five mips."""
    return [light.irradiance, *light.specular]


def _median_ms(run: Callable[[], object], device: torch.device, *, repeats: int) -> float:
    """Median wall time after one run to compile and fill caches."""
    times = []
    for _ in range(repeats + 1):
        _wait(device)
        start = time.perf_counter()
        run()
        _wait(device)
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[1:])


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
