"""``python -m samira_warp.bench light``: time and error of filtering, lookup and shading."""

from __future__ import annotations

import json as json_format
import tempfile
from functools import partial
from pathlib import Path

import OpenImageIO
import torch
from torch import Tensor

from samira_warp.bench.light_table import light_table, print_light_table
from samira_warp.bench.timing import hardware, least_ms
from samira_warp.kernels.cubemap.filter import irradiance, prefilter
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light.environment import Environment
from samira_warp.light.filtered import ROUGHNESS_STEP, FilteredLight
from samira_warp.light.learnable import LearnableLight
from samira_warp.light.shading import shade
from samira_warp.reference.cubemap import filter as reference
from samira_warp.surface import CHANNELS, Surface

SHADED_PIXELS = 65536
"""A frame of 256 x 256, every pixel covered."""

BRUTE_FORCE_LADDER = ((0.25, 16), (0.5, 8), (1.0, 8))
"""Roughness and size at which filters are compared with float64 sums over all pairs of texels."""

ENVIRONMENT_SIZE = 256
"""Texels along a face of a relighting environment."""

CHECKED_TEXELS = 24
"""Texels of each of its mips that are summed again in float64."""


def main(device: str, json: bool, hdri: Path | None = None) -> None:
    """Measure on ``device`` and print a table, or with ``json`` one object.

    Its fields: ``hardware``, ``device`` and ``threads``, what computed; ``furnace_max_error``, over all mips
    and the irradiance of a uniform light of 1; ``bruteforce_max_error``, over one-hot and random maps, by the
    peak; ``environment_max_error``, the same of a relighting environment of 256, at some of its texels;
    ``step_ms``, a training step's filtering, forward and adjoint; ``shade_ms`` and ``shade_adjoint_ms``, of
    65,536 pixels under the learned light; ``shade_quarter_ms`` and ``shade_quarter_adjoint_ms``, with three
    quarters of them uncovered; ``environment_ms``, a file of 1024 x 512 pixels to a filtered environment of
    256; ``monte_carlo``, see `bench.light_table`, for the maps in the folder ``hdri``.
    """
    place = torch.device(device)
    row = {
        "hardware": hardware(place),
        "device": device,
        "threads": torch.get_num_threads(),
        "furnace_max_error": _furnace_error(place),
        "bruteforce_max_error": _brute_force_error(place),
        "environment_max_error": _environment_error(place),
        "step_ms": _step_ms(place),
        **_shade_ms(place),
        "environment_ms": _environment_ms(place),
    }
    table = light_table(hdri, place) if hdri else []
    if json:
        print(json_format.dumps({**row, "monte_carlo": [errors._asdict() for errors in table]}))
        return
    for name, value in row.items():
        print(f"{name:26} {value:.3g}" if isinstance(value, float) else f"{name:26} {value}")
    if table:
        print_light_table(table)


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
        _, *exact = reference.prefilter(base, ladder=BRUTE_FORCE_LADDER)
        _, *ours = prefilter(single, ladder=BRUTE_FORCE_LADDER)
        exact.append(reference.irradiance(base))
        ours.append(irradiance(single))
        worst = max(
            worst, *(((a.cpu() - b).abs().max() / b.max()).item() for a, b in zip(ours, exact, strict=True))
        )
    return worst


def _environment_error(device: torch.device) -> float:
    """Of a random map with one bright texel, against sums over all its texels, by the peak of each mip."""
    generator = torch.Generator().manual_seed(0)
    size = ENVIRONMENT_SIZE
    base = torch.rand(6, size, size, 1, generator=generator)
    base[3, size // 3, size // 8] = 1e4
    light = FilteredLight.of(base.to(device), base.to(device))
    areas = texel_solid_angles(size, dtype=torch.float64).expand(6, size, size).flatten()
    sources, values = texel_directions(size, dtype=torch.float64).view(-1, 3), base.double().view(-1)
    worst = 0.0
    for roughness, mip in [
        (1.0, light.irradiance),
        *((ROUGHNESS_STEP * k, mip) for k, mip in enumerate(light.specular) if k),
    ]:
        found = mip.cpu().double().view(-1)
        # the brightest texel, where the lobe of the bright one peaks, and others at random
        chosen = torch.cat(
            [found.argmax()[None], torch.randint(len(found), (CHECKED_TEXELS - 1,), generator=generator)]
        )
        cosine = texel_directions(mip.shape[1], dtype=torch.float64).view(-1, 3)[chosen] @ sources.T
        weights = cosine.clamp(min=0) * areas / ((1 + cosine) / 2 * (roughness**4 - 1) + 1) ** 2
        exact = weights @ values / (torch.pi if mip is light.irradiance else weights.sum(dim=1))
        worst = max(worst, ((found[chosen] - exact).abs().max() / exact.max()).item())
    return worst


def _step_ms(device: torch.device) -> float:
    light = LearnableLight(torch.ones(3)).to(device)
    grad_maps = [torch.ones_like(mip) for mip in _maps(light())]

    def step() -> None:
        torch.autograd.grad(_maps(light()), list(light.parameters()), grad_maps)

    return least_ms(step, device, repeats=11)


def _shade_ms(device: torch.device) -> dict[str, float]:
    generator = torch.Generator().manual_seed(0)

    def random(channels: int) -> Tensor:
        return torch.rand(SHADED_PIXELS, channels, generator=generator)

    normal = torch.nn.functional.normalize(random(3) * 2 - 1, dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * (random(3) * 2 - 1), dim=-1).to(device)
    channels = {name: random(channel.width) for name, channel in CHANNELS.items()}
    surface = Surface(**{**channels, "normal": normal}).map(lambda values: values.to(device).requires_grad_())
    learned = LearnableLight(torch.ones(3)).to(device)()
    irradiance_map, *mips = maps = [mip.detach().requires_grad_() for mip in _maps(learned)]
    light = FilteredLight(irradiance_map, tuple(mips), learned.radiance.detach())
    times = {}
    for name, covered in (("shade", 1.0), ("shade_quarter", 0.25)):
        alpha = (
            (torch.arange(SHADED_PIXELS) < covered * SHADED_PIXELS)
            .float()[:, None]
            .to(device)
            .requires_grad_()
        )

        def run(alpha: Tensor = alpha) -> Tensor:
            return shade(surface, view, light, alpha=alpha).image

        def back(image: Tensor, alpha: Tensor = alpha) -> None:
            leaves = [*surface.channels().values(), alpha, *maps]
            torch.autograd.grad(image, leaves, torch.ones_like(image), retain_graph=True)

        image = run()
        times[f"{name}_ms"] = least_ms(run, device, repeats=11)
        times[f"{name}_adjoint_ms"] = least_ms(partial(back, image), device, repeats=11)
    return times


def _environment_ms(device: torch.device) -> float:
    panorama = torch.rand(512, 1024, 3, generator=torch.Generator().manual_seed(0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "light.hdr"
        OpenImageIO.ImageBuf(panorama.numpy()).write(str(path))
        return least_ms(
            lambda: Environment.load(path, size=ENVIRONMENT_SIZE).to(device).filtered(), device, repeats=3
        )


def _maps(light: FilteredLight) -> list[Tensor]:
    """Irradiance, and all mips of the specular light."""
    return [light.irradiance, *light.specular]
