"""Score a relit avatar against true relit frames, light by light, beside oracles with and without shadows.

usage: python tools/relight_table.py --avatar DIR --data DIR [--json]

The dataset brings gt/relight/LIGHT/NAME.png with LIGHT.json (file, azimuth_degrees, exposure), gt/normal,
gt/albedo, and gt/capture_light.json for its own images. The oracles are this package's shading of the true
normals and albedo, with skin's initial roughness and reflectance: what an avatar with perfect geometry and
albedo would score without shadows, and with those that the tracked mesh casts. All are scored as
`python -m samira_warp.evaluate` does.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from samira_warp.avatar import Avatar, CanonicalHead
from samira_warp.avatar.gaussians import SKIN_ROUGHNESS, SKIN_SPECULAR
from samira_warp.avatar.occlusion import Occluder, gaussian_arrival
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.evaluate import ImagePair, evaluate_images
from samira_warp.geometry.camera import Camera
from samira_warp.io.files import read_json
from samira_warp.io.images import read_image, resize_box, to_uint8
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.light import Environment, FilteredLight, compose, decode_srgb, shade
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, LIGHT_CHANNELS, Surface

MATTE_MIN = 0.05
"""Below this coverage an 8-bit albedo on white holds too little of the surface to recover it."""


@dataclass(frozen=True)
class TableConfig:
    """Score a relit avatar against true relit frames, beside oracles with and without shadows."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/relight, gt/normal and gt/albedo."""
    shadows: Literal["on", "off"] = "on"
    """Let the avatar's head block the light."""
    resolution: int = 256
    """Width and height of the comparison, pixels."""
    json: bool = False
    """Print JSON rows instead of a table."""


class Light(NamedTuple):
    """One light of the dataset and the frames that show it."""

    name: str
    environment: Environment
    truth: Path


@torch.no_grad()
def main(config: TableConfig) -> None:
    """One row a light."""
    avatar = Avatar.load(find_avatar(config.avatar))
    sequence = open_sequence(config.data)
    rows, caster = [], ShadowCaster.of(sequence)
    for light in read_lights(config.data):
        filtered = light.environment.filtered()
        predictions: dict[str, AvatarPrediction | OraclePrediction] = {
            "avatar": AvatarPrediction(avatar, filtered, config.shadows == "on"),
            "oracle": OraclePrediction(config.data, filtered, None),
            "oracle in shadow": OraclePrediction(config.data, filtered, caster),
        }
        row: dict[str, str | float] = {"light": light.name}
        for who, predict in predictions.items():
            shown = pairs(sequence, light, predict, resolution=config.resolution)
            score = evaluate_images(shown, protocol={})
            row |= {
                f"{who} PSNR": score["psnr"],
                f"{who} foreground": score["psnr_foreground"],
                f"{who} with gain": score["psnr_gain"],
            }
        rows.append(row)
    print_rows(rows, as_json=config.json)


def print_rows(rows: Sequence[Mapping[str, str | float]], *, as_json: bool) -> None:
    """Print rows with equal keys as one Markdown table, or as JSON."""
    if as_json:
        print(json.dumps(rows))
        return
    print("| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        cells = (value if isinstance(value, str) else f"{value:.2f}" for value in row.values())
        print("| " + " | ".join(cells) + " |")


def read_lights(data: Path) -> Iterator[Light]:
    """Every light with true frames, the capture light last."""
    descriptions = {path.stem: path for path in sorted((data / "gt" / "relight").glob("*.json"))}
    if not descriptions:
        raise UserError(
            data / "gt" / "relight", expected="LIGHT.json and LIGHT/ of relit frames", found="none"
        )
    folders = {name: path.with_suffix("") for name, path in descriptions.items()}
    descriptions["capture"], folders["capture"] = data / "gt" / "capture_light.json", data / "images"
    for name, path in descriptions.items():
        text = read_json(path)
        environment = Environment.load(
            data / text["file"], rotate=text["azimuth_degrees"], exposure=text["exposure"]
        )
        yield Light(name, environment, folders[name])


def pairs(
    sequence: TrackedSequence, light: Light, predict: AvatarPrediction | OraclePrediction, *, resolution: int
) -> Iterator[ImagePair]:
    """Prediction and truth of each test frame that the light's folder has.

    The capture light shows every tenth.
    """
    shown = [
        sequence.frames[index]
        for index in sequence.test
        if (light.truth / f"{sequence.frames[index].name}.png").is_file()
    ]
    if not shown:
        raise UserError(light.truth, expected="pictures named as the dataset's test frames", found="none")
    for frame in shown[min(4, len(shown) - 1) :: 10] if light.name == "capture" else shown:
        mask = matte_of(frame, resolution)
        truth = at_size(read_image(light.truth / f"{frame.name}.png", channels=3), resolution)
        image = predict(frame, frame.camera.resized(width=resolution, height=resolution), mask)
        yield ImagePair(
            frame.name, torch.from_numpy(to_uint8(image.numpy())).float() / 255.0, truth, mask=mask
        )


def matte_of(frame: Frame, resolution: int) -> torch.Tensor:
    """(H, W) coverage of a frame.

    Raises:
        UserError: The dataset has no mask of it.
    """
    if frame.mask_path is None:
        raise UserError(frame.image_path, expected="a picture with a mask", found="none")
    return at_size(read_image(frame.mask_path, channels=1), resolution)[..., 0]


class AvatarPrediction(NamedTuple):
    """The avatar under a light."""

    avatar: Avatar
    light: FilteredLight
    shadows: bool = True

    def __call__(self, frame: Frame, camera: Camera, mask: Tensor) -> Tensor:
        """(H, W, 3) display values on white."""
        return self.avatar.render(frame.parameters, camera, self.light, shadows=self.shadows).image


class ShadowCaster(NamedTuple):
    """The tracked mesh, pixel by pixel."""

    canonical: CanonicalHead
    occluder: Occluder

    @classmethod
    def of(cls, sequence: TrackedSequence) -> ShadowCaster:
        """The mesh of a sequence."""
        canonical = CanonicalHead.build(
            sequence.template, shape=sequence.shape, static_offset=sequence.static_offset, uv_size=64
        )
        return cls(canonical, Occluder(canonical.vertices, canonical.topology))

    def channels(self, frame: Frame, camera: Camera, light: FilteredLight) -> dict[str, Tensor]:
        """The channels of light of every pixel, (H W, width): the mesh's, or its nearest pixel's."""
        head = self.canonical.pose(frame.parameters)
        arrival = self.occluder.arrival(self.occluder.occlude(head), light, camera)
        roughness = torch.full((len(arrival), 1), SKIN_ROUGHNESS)
        values = gaussian_arrival(arrival, roughness)
        points = camera.image_points(head.vertices)[None]
        raster = rasterize_mesh(points, self.canonical.topology, width=camera.width, height=camera.height)
        pixels = interpolate(values[None].contiguous(), raster, self.canonical.topology)[0]
        nearest = distance_transform_edt(
            raster.face[0].numpy() < 0, return_distances=False, return_indices=True
        )
        filled = pixels[tuple(torch.from_numpy(place) for place in nearest)].flatten(0, 1)
        widths = [CHANNELS[name].width for name in LIGHT_CHANNELS]
        return dict(zip(LIGHT_CHANNELS, filled.split(widths, dim=1), strict=True))


class OraclePrediction(NamedTuple):
    """True normals and albedo under a light, with the shadows of a mesh or without any."""

    data: Path
    light: FilteredLight
    caster: ShadowCaster | None

    def __call__(self, frame: Frame, camera: Camera, mask: Tensor) -> Tensor:
        """(H, W, 3) display values on white."""
        normal, albedo = (layer.flatten(0, 1) for layer in true_layers(self.data, frame, mask))
        ones = torch.ones(len(normal), 1)
        surface = Surface.of(
            albedo=albedo,
            normal=normal,
            roughness=SKIN_ROUGHNESS * ones,
            specular=SKIN_SPECULAR * ones,
            **({} if self.caster is None else self.caster.channels(frame, camera, self.light)),
        )
        shaded = shade(surface, -camera.ray_directions().flatten(0, 1), self.light)
        return compose(shaded.color.unflatten(0, mask.shape), mask[..., None], 1.0)


def true_layers(data: Path, frame: Frame, mask: Tensor) -> tuple[Tensor, Tensor]:
    """(H, W, 3) unit normals and (H, W, 3) linear albedo of a frame, for its (H, W) matte."""
    normal, albedo = (
        at_size(read_image(data / "gt" / layer / f"{frame.name}.png", channels=3), mask.shape[1])
        for layer in ("normal", "albedo")
    )
    # the true albedo lies on white: at the matte's soft edge, take the white out again
    albedo = ((albedo - (1.0 - mask[..., None])) / mask[..., None].clamp(min=MATTE_MIN)).clamp(0.0, 1.0)
    return torch.nn.functional.normalize(2.0 * normal - 1.0, dim=-1), decode_srgb(albedo)


def at_size(image: np.ndarray, resolution: int) -> Tensor:
    """Box-resize an (H, W, C) array."""
    return torch.from_numpy(resize_box(image, width=resolution, height=resolution))


if __name__ == "__main__":
    sys.exit(run(main, TableConfig, program="python tools/relight_table.py"))
