"""Train an avatar, then show it under its own light and under others.

    python examples/train_and_relight.py --out runs/example
    python examples/train_and_relight.py --out runs/mine --data FOLDER --light studio.hdr forest.exr

Without --data that is the built-in subject: some twelve minutes on two cores, four of which make it, once.
The run folder is OUT, and OUT/relit.png shows a frame that did not train: its albedo, its normals, and the
head under the light that was learned with it and under each of the others.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from samira_warp import Avatar, Environment, read_frames
from samira_warp.io import write_png
from samira_warp.stage import contact_sheet, layer_image
from samira_warp.train import TrainConfig, train

LIGHTS = Path(__file__).parents[1] / "samira_warp" / "assets" / "lights"


@dataclass(frozen=True)
class Options:
    """Train an avatar, then show it under its own light and under others."""

    out: Path
    """The run folder, and where the picture goes."""
    data: Path | None = None
    """Dataset folder; default the built-in subject."""
    flame: Path | None = None
    """Head model of a dataset that brings none."""
    light: tuple[Path, ...] = (LIGHTS / "window.hdr", LIGHTS / "dusk.hdr", LIGHTS / "stage.hdr")
    """Panoramas or cube crosses to relight with."""
    max_steps: int | None = None
    """End training after so many steps; a dozen show that everything is in place, and nothing more."""
    gaussians: int | None = None
    """Gaussians at the start; default what the machine is good for."""
    resolution: int | None = None
    """Longer side of the pictures, pixels; default what the machine is good for."""


@torch.no_grad()
def relit(avatar: Avatar, lights: tuple[Path, ...], picture: Path) -> None:
    """Write a sheet of the first test frame: what it is made of, and under every light."""
    frame = next(frame for frame in read_frames(picture.parent) if frame.part == "test")
    learned = avatar.render(frame.parameters, frame.camera)
    pictures = {name: layer_image(learned, name).picture for name in ("albedo", "normal")}
    pictures["the learned light"] = learned.image
    for path in lights:
        # Every light at one brightness: its irradiance, averaged over all directions, is 1.
        light = Environment.load(path, exposure="auto", size=128)
        pictures[path.stem] = avatar.render(frame.parameters, frame.camera, light).image
    write_png(picture, contact_sheet([values.cpu().numpy() for values in pictures.values()], list(pictures)))


def main(options: Options) -> None:
    """Train, load what training wrote, and look at it."""
    run = train(
        TrainConfig(
            data=options.data,
            flame=options.flame,
            out=options.out,
            max_steps=options.max_steps,
            gaussians=options.gaussians,
            resolution=options.resolution,
        )
    )
    if run is None:  # Ctrl-C: there is a checkpoint to go on from, and no avatar yet
        sys.exit(130)
    relit(Avatar.load(run), options.light, run / "relit.png")


if __name__ == "__main__":
    main(tyro.cli(Options))
