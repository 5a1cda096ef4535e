"""Light an avatar with lamps: each alone, all together, turned, and exposed.

    python examples/light_rig.py --avatar runs/built_in --out rig

A light is radiance all around: here round lamps far away, with no file behind them. Light adds up, so the
picture under all lamps is, before it is encoded, the sum of the pictures under each. Turning a light and
exposing it cost nothing: what was filtered stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from samira_warp import Avatar, Environment, read_frames
from samira_warp.io import write_png
from samira_warp.light import DirectionalLight, LightRig
from samira_warp.stage import contact_sheet

SIZE = 64
"""Texels along a face of the lights' cubemaps; a lamp of 20 degrees is some fourteen of them wide."""


def towards(azimuth: float, elevation: float) -> tuple[float, float, float]:
    """The direction at degrees from straight before the face (+z) towards the subject's left (+x), and up."""
    around, up = math.radians(azimuth), math.radians(elevation)
    return math.cos(up) * math.sin(around), math.sin(up), math.cos(up) * math.cos(around)


RIG = {
    "key": DirectionalLight(towards(45.0, 35.0), irradiance=(4.7, 4.2, 3.6), radius=14.0),
    "fill": DirectionalLight(towards(-55.0, 5.0), irradiance=(0.94, 1.07, 1.32), radius=30.0),
    "rim": DirectionalLight(towards(-150.0, 30.0), irradiance=(5.0, 5.7, 6.6), radius=10.0),
}
"""A warm key from the subject's upper left, a wide cool fill opposite, a lamp behind for the outline.
`PointLight` and `AreaLight` stand in the room instead, `LightRig.load` reads them from a file."""


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
    lamps = {name: (lamp,) for name, lamp in RIG.items()} | {"all": tuple(RIG.values())}
    lights = {
        name: Environment.from_rig(LightRig(some), size=SIZE).filtered() for name, some in lamps.items()
    }
    whole = lights["all"]
    lights |= {f"turned_{degrees:g}": whole.turned(degrees) for degrees in options.turns}
    lights |= {f"stops_{stops:g}": whole.exposed(2.0**stops) for stops in options.stops}

    # The head is moved, rasterised and traced once: only the light changes.
    motion = avatar.move(frame.parameters)
    gbuffer = avatar.rasterize(motion, frame.camera)
    occlusion = avatar.occluder.occlude(motion.head)
    pictures = [
        avatar.shade(motion, gbuffer, frame.camera, light, background=0.0, occlusion=occlusion)
        .image.cpu()
        .numpy()
        for light in lights.values()
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    for name, picture in zip(lights, pictures, strict=True):
        write_png(options.out / f"{name}.png", picture)
    write_png(options.out / "sheet.png", contact_sheet(pictures, list(lights)))


if __name__ == "__main__":
    main(tyro.cli(Options))
