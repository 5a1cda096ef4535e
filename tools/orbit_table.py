"""Score an avatar from where no camera of its film stood: the built-in subject's gt/orbit, by yaw and pitch.

usage: python tools/orbit_table.py --avatar DIR --data DIR [--json]

Pictures are those of `python -m samira_warp.render --data DATA/gt/orbit`, and scored as
`python -m samira_warp.evaluate` does. Beside that stand, as shares of the whole frame, the opacity outside of
the head's true outline and what is lacking inside it.
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
from samira_warp.data import Frame, open_sequence
from samira_warp.data.pixels import load_pixels
from samira_warp.evaluate.metrics import FOREGROUND, psnr, psnr_where
from samira_warp.io.files import read_json
from samira_warp.io.images import to_uint8
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

MARGIN = 1
"""Pixels on either side of the true outline that count neither as outside nor as inside."""


@dataclass(frozen=True)
class OrbitConfig:
    """Score an avatar from all around."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    data: Path
    """Dataset with gt/orbit."""
    resolution: int = 256
    """Width and height of the comparison, pixels."""
    json: bool = False
    """Print JSON rows instead of a table."""


@torch.no_grad()
def main(config: OrbitConfig) -> None:
    """A row for each yaw to either side, one for each pitch, and one for all."""
    folder = config.data / "gt" / "orbit"
    if not (folder / "orbit.json").is_file():
        raise UserError(folder, expected="pictures from all around, with orbit.json", found="none")
    avatar = Avatar.load(find_avatar(config.avatar))
    angles = {row["name"]: (row["yaw"], row["pitch"]) for row in read_json(folder / "orbit.json")["frames"]}
    sequence = open_sequence(folder)
    scores: dict[str, list[dict[str, float]]] = {}
    for frame in (sequence.frames[index] for index in sequence.test):
        yaw, pitch = angles[frame.name]
        found = score(frame, avatar, resolution=config.resolution)
        for row in (f"yaw {abs(yaw)}" if pitch == 0 else f"pitch {pitch}", "all"):
            scores.setdefault(row, []).append(found)
    rows: list[dict[str, str | float]] = [
        {"view": row, "pictures": str(len(found)), **{name: mean_of(found, name) for name in found[0]}}
        for row, found in sorted(scores.items(), key=_order)
    ]
    print_rows(rows, as_json=config.json)


def score(frame: Frame, avatar: Avatar, *, resolution: int) -> dict[str, float]:
    """One picture's scores by name: dB, and per cent of the frame."""
    camera = frame.camera.resized(width=resolution, height=resolution)
    rendering = avatar.render(frame.parameters, camera)
    shown = torch.from_numpy(to_uint8(rendering.image.numpy())).float() / 255.0
    true = load_pixels(frame, width=resolution, height=resolution)
    return {
        "PSNR": float(psnr(shown, true.image)),
        "foreground": float(psnr_where(shown, true.image, true.mask > FOREGROUND)),
        **misplaced(rendering.gbuffer.alpha[..., 0], true.mask),
    }


def misplaced(alpha: Tensor, mask: Tensor) -> dict[str, float]:
    """Opacity where no head is, and what lacks of it where there is one, in per cent of the frame.

    Args:
        alpha: (H, W) the avatar's.
        mask: (H, W) true coverage.
    """
    outside = _grown(mask > 0.0, MARGIN) == 0.0
    inside = _grown(mask < 1.0, MARGIN) == 0.0
    return {
        "outside, %": 100.0 * float((alpha * outside).mean()),
        "lacking inside, %": 100.0 * float(((1.0 - alpha) * inside).mean()),
    }


def mean_of(scores: list[dict[str, float]], name: str) -> float:
    """Mean of a score over pictures."""
    return sum(score[name] for score in scores) / len(scores)


def _grown(where: Tensor, by: int) -> Tensor:
    """(H, W) 1 within so many pixels of where it is true."""
    return torch.nn.functional.max_pool2d(where.float()[None, None], 2 * by + 1, stride=1, padding=by)[0, 0]


def _order(row: tuple[str, object]) -> tuple[int, int]:
    """Where a row stands: yaws, then pitches, then all."""
    kind, _, degrees = row[0].partition(" ")
    return ["yaw", "pitch", "all"].index(kind), int(degrees or 0)


if __name__ == "__main__":
    sys.exit(run(main, OrbitConfig, program="python tools/orbit_table.py"))
