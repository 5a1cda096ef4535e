"""Make one row of pictures of an avatar: as captured, its albedo and normals, and under other lights.

Each light is behind the head, and its name below.

usage: python tools/overview.py --avatar DIR --env FILE.hdr ... --out FILE.png [--frame N] [--resolution N]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import torch

from samira_warp.avatar import Avatar, read_frames
from samira_warp.io.images import write_png
from samira_warp.light import Environment
from samira_warp.stage import Background, Scene, contact_sheet, layer_image
from samira_warp.stage.frames import frame_at
from samira_warp.stage.lights import sheet_labels
from samira_warp.support.cli import run

EXPOSURE = 0.8
"""Mean irradiance of every light: faces are then about as bright as in the frame as captured."""


@dataclass(frozen=True)
class OverviewConfig:
    """Make one row of pictures of an avatar: as captured, its albedo and normals, and under other lights."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    env: tuple[Path, ...]
    """Environment maps to relight under."""
    out: Path
    """The .png file to write."""
    frame: int = 0
    """Which of the avatar's own frames, test frames first."""
    resolution: int = 320
    """Longer side of each picture, pixels."""


@torch.no_grad()
def main(config: OverviewConfig) -> None:
    """Render the pictures and write them side by side."""
    avatar = Avatar.load(config.avatar)
    frame = frame_at(read_frames(config.avatar), config.frame)
    camera = frame.camera.with_longer_side(config.resolution)
    scene = Scene(avatar, (), Background("env", color_space=avatar.settings.color_space))
    view = scene.view(frame._replace(camera=camera))
    captured = scene.shade(view, avatar.light(), 1.0)
    pictures = [layer_image(captured, layer).picture for layer in ("image", "albedo", "normal")]
    for path in config.env:
        light = scene.light(Environment.load(path, exposure="auto").exposed(EXPOSURE))
        pictures.append(scene.relight(view, light).image)
    labels = ["as captured", "albedo", "normals", *sheet_labels(config.env)]
    row = [picture.clamp(0.0, 1.0).numpy() for picture in pictures]
    write_png(config.out, contact_sheet(row, labels, columns=len(row)))


if __name__ == "__main__":
    sys.exit(run(main, OverviewConfig, program="python tools/overview.py"))
