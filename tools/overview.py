"""Make one picture of an avatar: as captured, its albedo and normals, and under other lights.

Each light is behind the head.

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
from samira_warp.stage.layers import layer_image
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

EXPOSURE = 0.8
"""Mean irradiance of every light: faces are then about as bright as in the frame as captured."""


@dataclass(frozen=True)
class OverviewConfig:
    """Make one picture of an avatar: as captured, its albedo and normals, and under other lights."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    env: tuple[Path, ...]
    """Environment maps to relight under."""
    out: Path
    """The .png file to write."""
    frame: int = 0
    """Which of the avatar's own frames, test frames first."""
    resolution: int = 320
    """Width and height of each panel, pixels."""


@torch.no_grad()
def main(config: OverviewConfig) -> None:
    """Render the panels and write them side by side."""
    avatar, frames = Avatar.load(config.avatar), read_frames(config.avatar)
    if not 0 <= config.frame < len(frames):
        raise UserError("--frame", expected=f"0 to {len(frames) - 1}", found=config.frame)
    frame = frames[config.frame]
    camera = frame.camera.resized(width=config.resolution, height=config.resolution)
    captured = avatar.render(frame.parameters, camera)
    panels = [layer_image(captured, layer).picture for layer in ("image", "albedo", "normal")]
    for path in config.env:
        environment = Environment.load(path, exposure="auto").exposed(EXPOSURE)
        background = environment.background(camera, color_space=avatar.settings.color_space)
        panels.append(avatar.render(frame.parameters, camera, environment, background=background).image)
    write_png(config.out, torch.cat(panels, dim=1).clamp(0.0, 1.0).numpy())


if __name__ == "__main__":
    sys.exit(run(main, OverviewConfig, program="python tools/overview.py"))
