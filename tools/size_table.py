"""Score an avatar's pictures at other sizes than it was trained at, and say how large its Gaussians are.

usage: python tools/size_table.py --avatar DIR --data DIR [--json]

At twice the training size the truth is the dataset's own pictures, and the competitor the avatar's picture at
the training size, enlarged (bicubic). Brought down again by averaging, a picture of any size should be the
one at the training size.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import torch
from relight_table import print_rows
from torch import Tensor

from samira_warp.avatar import Avatar
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, PixelCache, open_sequence
from samira_warp.evaluate.metrics import psnr
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.support.cli import run

CACHE_BYTES = 1 << 28
"""Of true pictures."""


@dataclass(frozen=True)
class SizeConfig:
    """Score an avatar's pictures at other sizes than it was trained at."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with pictures of at least twice the training size."""
    resolution: int = 256
    """Longer side of the training pictures, pixels."""
    frames: int = 10
    """Test frames to render, evenly spaced."""
    json: bool = False
    """Print JSON rows instead of tables."""


@torch.no_grad()
def main(config: SizeConfig) -> None:
    """A table of scores by size, and one of the Gaussians' shapes."""
    avatar, sequence = Avatar.load(find_avatar(config.avatar)), open_sequence(config.data)
    chosen = sequence.test[:: max(len(sequence.test) // config.frames, 1)][: config.frames]
    small, double = config.resolution, 2 * config.resolution
    scores: dict[str, list[float]] = {}

    def add(what: str, prediction: Tensor, truth: Tensor) -> None:
        scores.setdefault(what, []).append(float(psnr(prediction, truth)))

    with (
        PixelCache(sequence.frames, resolution=small, max_bytes=CACHE_BYTES) as near,
        PixelCache(sequence.frames, resolution=double, max_bytes=CACHE_BYTES) as large,
    ):
        for index in chosen:
            frame = sequence.frames[index]
            own = rendered(avatar, frame, small)
            twice = rendered(avatar, frame, double)
            add(f"{small} against the truth", own, near[index].image)
            add(f"{double} against the truth", twice, large[index].image)
            add(f"{small} enlarged against the truth", enlarged(own), large[index].image)
            add(f"{double} brought down against {small}", averaged(twice, 2), own)
            add(
                f"{2 * double} brought down against {small}",
                averaged(rendered(avatar, frame, 2 * double), 4),
                own,
            )
            add(
                f"{small // 2} against {small} brought down",
                rendered(avatar, frame, small // 2),
                averaged(own, 2),
            )
    rows: list[dict[str, str | float]] = [
        {"picture": what, "PSNR": sum(values) / len(values)} for what, values in scores.items()
    ]
    print_rows(rows, as_json=config.json)
    print()
    print_rows([shapes(avatar)], as_json=config.json)


def rendered(avatar: Avatar, frame: Frame, resolution: int) -> Tensor:
    """(H, W, 3) a frame on white."""
    image = avatar.render(frame.parameters, frame.camera.with_longer_side(resolution)).image
    return image.clamp(0.0, 1.0)


def averaged(image: Tensor, times: int) -> Tensor:
    """The means over squares of so many pixels a side."""
    return torch.nn.functional.avg_pool2d(image.permute(2, 0, 1), times).permute(1, 2, 0)


def enlarged(image: Tensor) -> Tensor:
    """Twice the size, bicubic."""
    planes = image.permute(2, 0, 1)[None]
    twice = torch.nn.functional.interpolate(planes, scale_factor=2, mode="bicubic", align_corners=False)
    return twice[0].permute(1, 2, 0).clamp(0.0, 1.0)


def shapes(avatar: Avatar) -> dict[str, str | float]:
    """How many Gaussians there are, and how long and thin on the head at rest."""
    canonical, gaussians = avatar.canonical, avatar.gaussians
    face_scales = triangle_frames(canonical.vertices, canonical.topology).scale[gaussians.faces.long()]
    own = gaussians.scales * face_scales[:, None]
    axes = (own.square() + avatar.settings.smoothing**2).sqrt().sort(dim=1).values
    return {
        "Gaussians": str(len(gaussians)),
        "axis ratio, 99th percentile": float(torch.quantile(axes[:, 2] / axes[:, 0], 0.99)),
        "longest axis, mm": 1e3 * float(axes[:, 2].max()),
    }


if __name__ == "__main__":
    sys.exit(run(main, SizeConfig, program="python tools/size_table.py"))
