"""How far shading is from the truth under real lights.

Spheres and a head, against Monte Carlo of the same split-sum terms.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.bench.light_truth import Panorama, brdf_terms, seen_light
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.light.environment import Environment
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.light.shading import shade
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError
from samira_warp.surface import Surface

SPHERE_ROUGHNESS = (0.1, 0.25, 0.35, 0.5, 0.75, 1.0)
"""Roughness of the spheres: 0.1 and 0.35 are blends of two mips, the others are mips of their own."""

POINTS = 100
"""Shaded points of each object."""

SAMPLES = 8192
"""Monte Carlo samples of each integral, by the lobe and as many by the light."""


class Points(NamedTuple):
    """What `light.shading.shade` takes of shaded points, their light apart.

    Attributes:
        surface: Channels (POINTS, width) float32.
        view: (POINTS, 3) unit vectors to the camera.
    """

    surface: Surface
    view: Tensor


class Errors(NamedTuple):
    """How far a shaded object is from the truth, all in linear radiance.

    Attributes:
        map: Name of the light.
        object: Name of what it lights.
        irradiance: Root mean square error of L_d over its mean.
        specular_light: Likewise of L_s.
        color: Likewise of C_fg.
        noise: Standard error of the true C_fg over its mean.
    """

    map: str
    object: str
    irradiance: float
    specular_light: float
    color: float
    noise: float


def light_table(folder: Path, device: torch.device) -> list[Errors]:
    """One row per map in ``folder`` and object.

    Raises:
        UserError: The folder holds no maps, or one cannot be read or is a cube cross.
    """
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".hdr", ".exr"))
    if not paths:
        raise UserError(folder, expected="a folder of .hdr or .exr maps", found="none")
    objects = {f"sphere {roughness:g}": sphere(roughness) for roughness in SPHERE_ROUGHNESS} | {
        "head": head()
    }
    rows = []
    for path in paths:
        panorama = _read_panorama(path)
        light = Environment.load(path).to(device).filtered()
        for name, points in objects.items():
            surface = points.surface.map(lambda values: values.to(device))
            shaded = shade(surface, points.view.to(device), light)
            truth, noise = true_light(points, panorama, np.random.default_rng(0))
            irradiance, specular_light, color = (
                _relative(found.cpu().double().numpy() - exact, exact)
                for found, exact in zip(
                    (shaded.irradiance, shaded.specular_light, shaded.color), truth, strict=True
                )
            )
            *_, true_color = truth
            of_noise = _relative(noise, true_color)
            rows.append(Errors(path.stem, name, irradiance, specular_light, color, of_noise))
    return rows


def _read_panorama(path: Path) -> Panorama:
    radiance = RadianceMap.read(path)
    if radiance.face_size is not None:
        raise UserError(
            path,
            expected="an equirectangular map, twice as wide as high, which is sampled as it is",
            found="a cube cross",
        )
    return Panorama(radiance.texels.double().numpy())


def true_light(
    points: Points, panorama: Panorama, generator: np.random.Generator
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """L_d, L_s and C_fg (M, 3) of a surface, float64, by Monte Carlo, and the standard error of C_fg."""
    channels = {name: values.double().numpy() for name, values in points.surface.channels().items()}
    normal, roughness, f = channels["normal"], channels["roughness"], channels["specular"]
    tau_d, tau_s = channels["response_diffuse"], channels["response_specular"]
    view = points.view.double().numpy()
    cosine = (normal * view).sum(axis=-1, keepdims=True)
    reflected = 2 * cosine * normal - view
    reflected /= np.linalg.norm(reflected, axis=-1, keepdims=True)
    diffuse = seen_light(panorama, normal, np.ones(len(normal)), samples=SAMPLES, generator=generator)
    shine = seen_light(panorama, reflected, roughness[:, 0], samples=SAMPLES, generator=generator)
    terms = brdf_terms(roughness[:, 0], cosine[:, 0], samples=SAMPLES, generator=generator)
    factor, factor_error = (f * part[:, :1] + part[:, 1:] for part in terms)
    matte = channels["albedo"] * (1 - f) * tau_d
    color = matte * diffuse.mean + tau_s * shine.mean * factor
    error = np.sqrt(
        (matte * diffuse.error) ** 2
        + (tau_s * shine.error * factor) ** 2
        + (tau_s * shine.mean * factor_error) ** 2
    )
    return (tau_d * diffuse.mean, tau_s * shine.mean, color), error


def sphere(roughness: float) -> Points:
    """A grey sphere of reflectance 0.04 seen from +z.

    Its points are evenly spread (Vogel's spiral) to 75 degrees from the centre.
    """
    index = np.arange(POINTS) + 0.5
    radius, turn = np.sin(np.radians(75)) * np.sqrt(index / POINTS), index * np.pi * (3 - np.sqrt(5))
    places = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=-1)
    ones = torch.ones(POINTS, 1)
    surface = Surface.of(
        albedo=0.5 * ones.expand(-1, 3),
        normal=torch.from_numpy(places).float(),
        roughness=roughness * ones,
        specular=0.04 * ones,
    )
    return Points(surface, torch.tensor([0.0, 0.0, 1.0]).expand(POINTS, 3).contiguous())


@torch.no_grad()
def head() -> Points:
    """Points of the G-buffer of the benchmark's head that face the camera."""
    avatar, camera = make_avatar("cpu", device="cpu"), make_camera(64)
    gbuffer = avatar.rasterize(avatar.move(make_parameters(0)), camera)
    view = -camera.ray_directions()
    facing = (gbuffer.alpha >= max(COVERED_ALPHA, 0.5))[..., 0] & ((gbuffer.normal * view).sum(dim=-1) > 0.1)
    chosen = facing.flatten().nonzero()[:, 0]
    chosen = chosen[torch.linspace(0, len(chosen) - 1, POINTS).long()]
    surface = gbuffer.map(lambda values: values.flatten(0, 1)[chosen])
    return Points(surface, view.flatten(0, 1)[chosen])


def print_light_table(rows: list[Errors]) -> None:
    """One line per map: per cent of error of L_d, of L_s by object, of C_fg on the head, and its noise."""
    by_map: dict[str, dict[str, Errors]] = {}
    for row in rows:
        by_map.setdefault(row.map, {})[row.object] = row
    width = max(map(len, by_map))
    spheres = [name for name in next(iter(by_map.values())) if name != "head"]
    print(
        "\nper cent of the mean, root mean square, against Monte Carlo: "
        "L_d and C_fg on the head, L_s on spheres by roughness"
    )
    titles = ["L_d", *(name.removeprefix("sphere ") for name in spheres), "L_s head", "C_fg head", "noise"]
    print(" ".join(["map".ljust(width), *(title.rjust(9) for title in titles)]))
    for name, found in by_map.items():
        on_head = found["head"]
        values = [on_head.irradiance, *(found[sphere].specular_light for sphere in spheres)]
        values += [on_head.specular_light, on_head.color, on_head.noise]
        print(" ".join([name.ljust(width), *(f"{100 * value:9.2f}" for value in values)]))


def _relative(error: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(error).mean()) / truth.mean())
