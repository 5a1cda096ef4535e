"""How far shading is from the truth under real lights: spheres and a head, against Monte Carlo of the same
split-sum terms.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar.gbuffer import SurfaceAttributes
from samira_warp.bench.light_truth import Panorama, brdf_terms, seen_light
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters
from samira_warp.light.environment import Environment
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.light.shading import shade
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError

SPHERE_ROUGHNESS = (0.1, 0.25, 0.35, 0.5, 0.75, 1.0)
"""Roughness of the spheres: 0.1 and 0.35 are blends of two mips, the others are mips of their own."""

POINTS = 100
"""Shaded points of each object."""

SAMPLES = 8192
"""Monte Carlo samples of each integral, by the lobe and as many by the light."""


class Surface(NamedTuple):
    """Points of a G-buffer, float32: see `light.shading.shade`."""

    albedo: Tensor
    normal: Tensor
    roughness: Tensor
    specular: Tensor
    response_diffuse: Tensor
    response_specular: Tensor
    view: Tensor


def light_table(folder: Path, device: torch.device) -> list[dict[str, object]]:
    """One row per map in ``folder`` and object: root mean square errors over the mean of the truth, all in
    linear radiance.

    Fields: ``map``; ``object``; ``irradiance``, ``specular_light`` and ``color``, the errors of L_d, L_s and
        C_fg; and ``noise``, the
    standard error of the true C_fg itself.

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
        for name, surface in objects.items():
            shaded = shade(*(values.to(device) for values in surface), light)
            found = (
                value.cpu().double().numpy()
                for value in (shaded.irradiance, shaded.specular_light, shaded.color)
            )
            truth, noise = true_light(surface, panorama, np.random.default_rng(0))
            errors = {
                term: _relative(mine - exact, exact)
                for term, mine, exact in zip(
                    ("irradiance", "specular_light", "color"), found, truth, strict=True
                )
            }
            rows.append({"map": path.stem, "object": name, **errors, "noise": _relative(noise, truth[-1])})
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
    surface: Surface, panorama: Panorama, generator: np.random.Generator
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """L_d, L_s and C_fg (M, 3) of a surface, float64, by Monte Carlo, and the standard error of C_fg."""
    albedo, normal, roughness, f, tau_d, tau_s, view = (values.double().numpy() for values in surface)
    cosine = (normal * view).sum(axis=-1, keepdims=True)
    reflected = 2 * cosine * normal - view
    reflected /= np.linalg.norm(reflected, axis=-1, keepdims=True)
    options = {"samples": SAMPLES, "generator": generator}
    diffuse = seen_light(panorama, normal, np.ones(len(normal)), **options)
    shine = seen_light(panorama, reflected, roughness[:, 0], **options)
    terms = brdf_terms(roughness[:, 0], cosine[:, 0], **options)
    factor, factor_error = (f * part[:, :1] + part[:, 1:] for part in terms)
    matte = albedo * (1 - f) * tau_d
    color = matte * diffuse.mean + tau_s * shine.mean * factor
    error = np.sqrt(
        (matte * diffuse.error) ** 2
        + (tau_s * shine.error * factor) ** 2
        + (tau_s * shine.mean * factor_error) ** 2
    )
    return (tau_d * diffuse.mean, tau_s * shine.mean, color), error


def sphere(roughness: float) -> Surface:
    """A grey sphere of reflectance 0.04 seen from +z, its points evenly spread (Vogel's spiral) to 75 degrees
    from the centre.
    """
    index = np.arange(POINTS) + 0.5
    radius, turn = np.sin(np.radians(75)) * np.sqrt(index / POINTS), index * np.pi * (3 - np.sqrt(5))
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=-1)
    normal, ones = torch.from_numpy(points).float(), torch.ones(POINTS, 1)
    towards = torch.tensor([0.0, 0.0, 1.0]).expand(POINTS, 3).contiguous()
    return Surface(0.5 * ones.expand(-1, 3), normal, roughness * ones, 0.04 * ones, ones, ones, towards)


@torch.no_grad()
def head() -> Surface:
    """Points of the G-buffer of the benchmark's head that face the camera."""
    avatar, camera = make_avatar("cpu", device="cpu"), make_camera(64)
    gbuffer = avatar.rasterize(avatar.move(make_parameters(0)), camera)
    view = -camera.ray_directions()
    facing = (gbuffer.alpha >= max(COVERED_ALPHA, 0.5))[..., 0] & ((gbuffer.normal * view).sum(dim=-1) > 0.1)
    chosen = facing.flatten().nonzero()[:, 0]
    chosen = chosen[torch.linspace(0, len(chosen) - 1, POINTS).long()]
    channels = {name: getattr(gbuffer, name).flatten(0, 1)[chosen] for name in SurfaceAttributes._fields}
    return Surface(**channels, view=view.flatten(0, 1)[chosen])


def print_light_table(rows: list[dict[str, object]]) -> None:
    """One line per map: per cent of error of L_d and, per object, of L_s; then of C_fg on the head, and what
    of that is noise.
    """
    by_map: dict[str, dict[str, dict[str, object]]] = {}
    for row in rows:
        by_map.setdefault(str(row["map"]), {})[str(row["object"])] = row
    width = max(map(len, by_map))
    spheres = [name for name in next(iter(by_map.values())) if name != "head"]
    print(
        "\nper cent of the mean, root mean square, against Monte Carlo: L_d and C_fg on the head, L_s on spheres by roughness"
    )
    titles = ["L_d", *(name.removeprefix("sphere ") for name in spheres), "L_s head", "C_fg head", "noise"]
    print(" ".join(["map".ljust(width), *(title.rjust(9) for title in titles)]))
    for name, found in by_map.items():
        on_head = found["head"]
        values = [on_head["irradiance"], *(found[sphere]["specular_light"] for sphere in spheres)]
        values += [on_head["specular_light"], on_head["color"], on_head["noise"]]
        print(" ".join([name.ljust(width), *(f"{100 * value:9.2f}" for value in values)]))


def _relative(error: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(error).mean()) / truth.mean())
