"""What a relit avatar lacks: give it the truth, channel by channel, and score it under true lights.

usage: python tools/swap_channels.py --avatar DIR --data DIR [--every N] [--json]

The dataset is one that `tools/relight_table.py` takes. Each row is the avatar's own G-buffer with something
of the truth in its place, the last with all of it: that tool's oracle in shadow.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from relight_table import Light, ShadowCaster, at_size, matte_of, print_rows, read_lights, true_layers
from torch import Tensor

from samira_warp.avatar import Avatar
from samira_warp.avatar.gaussians import SKIN_ROUGHNESS, SKIN_SPECULAR
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.evaluate.metrics import psnr
from samira_warp.io.images import read_image, to_uint8
from samira_warp.light import FilteredLight, compose, shade
from samira_warp.support.cli import run
from samira_warp.surface import CHANNELS, Surface


@dataclass(frozen=True)
class SwapConfig:
    """Give a relit avatar the truth, channel by channel, and score it under true lights."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/relight, gt/normal and gt/albedo."""
    every: int = 3
    """Score every such frame that is relit."""
    resolution: int = 256
    """Width and height of the comparison, pixels."""
    json: bool = False
    """Print JSON rows instead of a table."""


class Layers(NamedTuple):
    """A frame's channels (H, W, width) by name, and its coverage (H, W, 1)."""

    channels: dict[str, Tensor]
    alpha: Tensor


class Truth(NamedTuple):
    """What may be put in the place of an avatar's.

    Attributes:
        normal: (H, W, 3) unit vectors in the world.
        albedo: (H, W, 3) linear.
        mask: (H, W) matte.
        arrival: Channels of light past the tracked mesh, (H, W, width).
    """

    normal: Tensor
    albedo: Tensor
    mask: Tensor
    arrival: dict[str, Tensor]


def _materials(own: Layers, truth: Truth) -> Layers:
    ones = torch.ones_like(own.alpha)
    given = {"roughness": SKIN_ROUGHNESS * ones, "specular": SKIN_SPECULAR * ones}
    return own._replace(channels=own.channels | given)


def _responses(own: Layers, truth: Truth) -> Layers:
    ones = torch.ones_like(own.alpha)
    return own._replace(channels=own.channels | {"response_diffuse": ones, "response_specular": ones})


SWAPS: dict[str, Callable[[Layers, Truth], Layers]] = {
    "normals": lambda own, truth: own._replace(channels=own.channels | {"normal": truth.normal}),
    "albedo": lambda own, truth: own._replace(channels=own.channels | {"albedo": truth.albedo}),
    "matte": lambda own, truth: own._replace(alpha=truth.mask[..., None]),
    "shadows of the mesh": lambda own, truth: own._replace(channels=own.channels | truth.arrival),
    "first roughness and reflectance": _materials,
    "response factors of 1": _responses,
}
"""What each row puts in the avatar's place."""


def _all_of_it(own: Layers, truth: Truth) -> Layers:
    for swap in SWAPS.values():
        own = swap(own, truth)
    return own


ROWS = {"as learned": lambda own, truth: own, **SWAPS, "all of it": _all_of_it}


@torch.no_grad()
def main(config: SwapConfig) -> None:
    """A row for each swap, a column for each light."""
    avatar, sequence = Avatar.load(find_avatar(config.avatar)), open_sequence(config.data)
    caster, table = ShadowCaster.of(sequence), {name: dict[str, float]() for name in ROWS}
    for light in read_lights(config.data):
        filtered, scores = light.environment.filtered(), {name: list[float]() for name in ROWS}
        for frame in _shown(sequence, light, config.every):
            picture = read_image(light.truth / f"{frame.name}.png", channels=3)
            seen = _Seen.of(config, avatar, caster, frame, filtered)
            for name, swap in ROWS.items():
                image = seen.shaded(swap(seen.own, seen.truth))
                shown = torch.from_numpy(to_uint8(image.numpy())).float() / 255.0
                scores[name].append(float(psnr(shown, at_size(picture, config.resolution))))
        for name, values in scores.items():
            table[name][light.name] = sum(values) / len(values)
    print_rows([{"given": name, **scores} for name, scores in table.items()], as_json=config.json)


class _Seen(NamedTuple):
    """A frame under a light."""

    own: Layers
    truth: Truth
    views: Tensor
    light: FilteredLight

    @classmethod
    def of(
        cls, config: SwapConfig, avatar: Avatar, caster: ShadowCaster, frame: Frame, light: FilteredLight
    ) -> _Seen:
        """What the avatar has there, and what is true."""
        mask = matte_of(frame, config.resolution)
        camera = frame.camera.resized(width=config.resolution, height=config.resolution)
        gbuffer = avatar.render(frame.parameters, camera, light).gbuffer
        arrival = caster.channels(frame, camera, light)
        shaped = {name: values.unflatten(0, mask.shape) for name, values in arrival.items()}
        own = Layers({name: getattr(gbuffer, name) for name in CHANNELS}, gbuffer.alpha)
        truth = Truth(*true_layers(config.data, frame, mask), mask, shaped)
        return cls(own, truth, -camera.ray_directions().flatten(0, 1), light)

    def shaded(self, layers: Layers) -> Tensor:
        """(H, W, 3) display values on white."""
        flat = {name: values.flatten(0, 1) for name, values in layers.channels.items()}
        color = shade(Surface.of(**flat), self.views, self.light).color
        return compose(color.unflatten(0, layers.alpha.shape[:2]), layers.alpha, 1.0)


def _shown(sequence: TrackedSequence, light: Light, every: int) -> Iterator[Frame]:
    """Test frames that the light's folder has; of the capture light, which has all, a tenth as many."""
    frames = [sequence.frames[index] for index in sequence.test]
    relit = [frame for frame in frames if (light.truth / f"{frame.name}.png").is_file()]
    yield from relit[:: every * 10 if light.name == "capture" else every]


if __name__ == "__main__":
    sys.exit(run(main, SwapConfig, program="python tools/swap_channels.py"))
