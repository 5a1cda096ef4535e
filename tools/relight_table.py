"""Score a relit avatar against true relit frames, light by light, beside an oracle without shadows.

usage: python tools/relight_table.py --avatar DIR --data DIR [--json]

The dataset brings gt/relight/LIGHT/NAME.png with LIGHT.json (file, azimuth_degrees, exposure), gt/normal,
gt/albedo, and gt/capture_light.json for its own images. The oracle is this package's shading of the true
normals and albedo, with skin's initial roughness and reflectance: what an avatar with perfect geometry and
albedo would score without visibility. Both are scored as `python -m samira_warp.evaluate` does.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import Avatar
from samira_warp.avatar.gaussians import INITIAL_ROUGHNESS, INITIAL_SPECULAR
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.evaluate import ImagePair, evaluate_images
from samira_warp.geometry.camera import Camera
from samira_warp.io.files import read_json
from samira_warp.io.images import read_image, resize_box, to_uint8
from samira_warp.light import Environment, FilteredLight, compose, decode_srgb, shade
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.surface import Surface

MATTE_MIN = 0.05
"""Below this coverage an 8-bit albedo on white holds too little of the surface to recover it."""


@dataclass(frozen=True)
class TableConfig:
    """Score a relit avatar against true relit frames, light by light, beside an oracle without shadows."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/relight, gt/normal and gt/albedo."""
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
    rows = []
    for light in read_lights(config.data):
        filtered = light.environment.filtered()
        scores = [
            evaluate_images(pairs(sequence, light, predict, resolution=config.resolution), protocol={})
            for predict in (AvatarPrediction(avatar, filtered), OraclePrediction(config.data, filtered))
        ]
        row = {"light": light.name}
        for who, score in zip(("avatar", "oracle"), scores, strict=True):
            row |= {
                f"{who} PSNR": score["psnr"],
                f"{who} foreground": score["psnr_foreground"],
                f"{who} with gain": score["psnr_gain"],
            }
        rows.append(row)
    if config.json:
        print(json.dumps(rows))
        return
    print("| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        print(
            "| "
            + " | ".join(value if isinstance(value, str) else f"{value:.2f}" for value in row.values())
            + " |"
        )


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

    def __call__(self, frame: Frame, camera: Camera, mask: Tensor) -> Tensor:
        """(H, W, 3) display values on white."""
        return self.avatar.render(frame.parameters, camera, self.light).image


class OraclePrediction(NamedTuple):
    """True normals and albedo under a light."""

    data: Path
    light: FilteredLight

    def __call__(self, frame: Frame, camera: Camera, mask: Tensor) -> Tensor:
        """(H, W, 3) display values on white."""
        normal, albedo = (
            at_size(read_image(self.data / "gt" / layer / f"{frame.name}.png", channels=3), camera.width)
            for layer in ("normal", "albedo")
        )
        # the true albedo lies on white: at the matte's soft edge, take the white out again
        albedo = ((albedo - (1.0 - mask[..., None])) / mask[..., None].clamp(min=MATTE_MIN)).clamp(0.0, 1.0)
        normal = torch.nn.functional.normalize(2.0 * normal - 1.0, dim=-1).flatten(0, 1)
        ones = torch.ones(len(normal), 1)
        surface = Surface.of(
            albedo=decode_srgb(albedo).flatten(0, 1),
            normal=normal,
            roughness=INITIAL_ROUGHNESS * ones,
            specular=INITIAL_SPECULAR * ones,
        )
        shaded = shade(surface, -camera.ray_directions().flatten(0, 1), self.light)
        return compose(shaded.color.unflatten(0, mask.shape), mask[..., None], 1.0)


def at_size(image: np.ndarray, resolution: int) -> Tensor:
    """Box-resize an (H, W, C) array."""
    return torch.from_numpy(resize_box(image, width=resolution, height=resolution))


if __name__ == "__main__":
    sys.exit(run(main, TableConfig, program="python tools/relight_table.py"))
