"""Light an avatar with lamps: each alone, all together, turned, and exposed.

    python examples/light_rig.py --avatar runs/built_in --out rig

A light is radiance all around: here a panorama that is a tensor, painted lamp by lamp, no file behind it.
Light adds up, so the picture under all lamps is, before it is encoded, the sum of the pictures under each.
Turning a light and exposing it cost nothing: what was filtered stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
import tyro
from torch import Tensor

from samira_warp import Avatar, Environment, read_frames
from samira_warp.io import write_png
from samira_warp.light import equirect_directions
from samira_warp.stage import contact_sheet

HEIGHT = 64
"""Rows of the panoramas; a lamp of 20 degrees is seven of them wide."""


class Lamp(NamedTuple):
    """A round lamp, infinitely far away.

    Attributes:
        azimuth: Degrees from straight before the face (+z) towards the subject's left (+x).
        elevation: Degrees above the horizon.
        radius: Degrees from its middle to its edge.
        power: Linear red, green and blue of the light that it throws on a card that faces it.
    """

    azimuth: float
    elevation: float
    radius: float
    power: tuple[float, float, float]

    def radiance(self) -> Tensor:
        """(HEIGHT, 2 HEIGHT, 3) float32 panorama of the lamp in the dark."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        towards = torch.tensor(
            [
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
                math.cos(elevation) * math.cos(azimuth),
            ]
        )
        cosine, edge = equirect_directions(HEIGHT) @ towards, math.cos(math.radians(self.radius))
        # The edge fades over a pixel. A disc of radiance L gives a card that faces it L sin(radius)^2.
        softness = math.sin(math.radians(self.radius)) * math.pi / HEIGHT
        disc = ((cosine - edge) / softness + 0.5).clamp(0.0, 1.0)
        return disc[..., None] * torch.tensor(self.power) / math.sin(math.radians(self.radius)) ** 2


RIG = {
    "key": Lamp(45.0, 35.0, 14.0, (1.5, 1.35, 1.15)),
    "fill": Lamp(-55.0, 5.0, 30.0, (0.30, 0.34, 0.42)),
    "rim": Lamp(-150.0, 30.0, 10.0, (1.6, 1.8, 2.1)),
}
"""A warm key from the subject's upper left, a wide cool fill opposite, a lamp behind for the outline."""


@dataclass(frozen=True)
class Options:
    """Light an avatar with lamps: each alone, all together, turned, and exposed."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """Folder of the pictures: one for each light, and sheet.png with all of them."""
    frame: int = 0
    """Which of the avatar's own frames, test frames first."""
    turns: tuple[float, ...] = (90.0, 180.0, 270.0)
    """Degrees by which the whole rig is turned, a picture each."""
    stops: tuple[float, ...] = (-1.0, 1.0)
    """Exposures in stops, a picture each; a stop doubles the light."""


@torch.no_grad()
def main(options: Options) -> None:
    """Render one frame under every light."""
    avatar = Avatar.load(options.avatar)
    frame = read_frames(options.avatar)[options.frame]
    lamps = {name: Environment.from_panorama(lamp.radiance(), size=HEIGHT) for name, lamp in RIG.items()}
    rig = Environment.from_panorama(sum(lamp.radiance() for lamp in RIG.values()), size=HEIGHT)
    lights = {name: lamp.filtered() for name, lamp in lamps.items()}
    whole = lights["all"] = rig.filtered()
    lights |= {f"turned_{degrees:g}": whole.turned(degrees) for degrees in options.turns}
    lights |= {f"stops_{stops:g}": whole.exposed(2.0**stops) for stops in options.stops}

    # The head is moved and rasterised once: only the light changes.
    motion = avatar.move(frame.parameters)
    gbuffer = avatar.rasterize(motion, frame.camera)
    pictures = [
        avatar.shade(motion, gbuffer, frame.camera, light, background=0.0).image.cpu().numpy()
        for light in lights.values()
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    for name, picture in zip(lights, pictures, strict=True):
        write_png(options.out / f"{name}.png", picture)
    write_png(options.out / "sheet.png", contact_sheet(pictures, list(lights)))


if __name__ == "__main__":
    main(tyro.cli(Options))
