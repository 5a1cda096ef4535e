"""How much of a motion that no template shape has an avatar's residual recovers, region by region.

usage: python tools/motion_table.py --avatar DIR [DIR ...] --data DIR [--split train] [--json]

The dataset brings gt/hidden_motion.npz (tools/make_subject.py --hidden-motion). Motion is compared in the
head's axes, on every texel that faces the camera in a frame and really moves, less its mean over the
training frames, which Gaussians take up by where they rest. Recovered is the share of the true energy
that the residual leaves no error in: 100 where it is the truth, 0 where it is nothing; the same of its parts
sideways and upward, for what moves sideways in proportion to the head's yaw looks to one camera as if it lay
deeper. Followed is how far the residual goes of the true way, along it: of a residual that is half the truth,
50, and 75 are recovered. Moving pixels are those that show a triangle which is off by MOVING in that frame.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from relight_table import at_size, print_rows
from torch import Tensor

from samira_warp.avatar import Avatar
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import Frame, TrackedSequence, open_sequence
from samira_warp.evaluate.metrics import psnr_where
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head import REGIONS
from samira_warp.io.images import read_image, to_uint8
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

MOVING = 2e-4
"""Metres, a sixth of a pixel of the built-in subject: root mean square over the test frames of a texel that
moves, and of a triangle in the frame that is scored."""

LEAST_SHARE = 0.01
"""Of a motion's energy: along an axis that has less there is no motion to recover."""

FACING = 0.2
"""Cosine between a texel's normal and the way to the camera above which the camera sees how it moves."""


@dataclass(frozen=True)
class MotionTableConfig:
    """Compare avatars' residual motion with the true one."""

    avatar: list[Path]
    """Avatar folders, or the run folders that they are in."""
    data: Path
    """Dataset with gt/hidden_motion.npz."""
    split: Literal["test", "train"] = "test"
    """Frames whose motion is compared."""
    resolution: int = 256
    """Width and height of the pictures compared, pixels."""
    json: bool = False
    """Print JSON rows instead of a table."""


class Tracks(NamedTuple):
    """Motion of every texel in some frames.

    Attributes:
        truth: (T, M, 3) metres in the head's axes.
        residual: (T, M, 3) the avatar's.
        facing: (T, M) bool, texels that face the camera.
    """

    truth: Tensor
    residual: Tensor
    facing: Tensor


@torch.no_grad()
def main(config: MotionTableConfig) -> None:
    """Rows for each avatar: every region that moves, and all of them."""
    hidden, sequence = read_hidden(config.data), open_sequence(config.data)
    rows = []
    for folder in config.avatar:
        avatar = Avatar.load(find_avatar(folder))
        train = tracks(avatar, sequence, sequence.train, hidden)
        indices = sequence.test if config.split == "test" else sequence.train
        compared = tracks(avatar, sequence, indices, hidden)
        decibels = moving_pixels(avatar, sequence, indices, hidden, resolution=config.resolution)
        for row in region_rows(avatar, train, compared):
            rows.append({"avatar": folder.name, **row, "moving pixels, dB": decibels})
    print_rows(rows, as_json=config.json)


def read_hidden(data: Path) -> Tensor:
    """(frames, V, 3) metres along the world's axes.

    Raises:
        UserError: The dataset has none.
    """
    path = data / "gt" / "hidden_motion.npz"
    if not path.is_file():
        raise UserError(path, expected="the motion that the tracks do not say", found="no such file")
    return torch.from_numpy(np.load(path)["displacement"])


def tracks(avatar: Avatar, sequence: TrackedSequence, indices: Sequence[int], hidden: Tensor) -> Tracks:
    """The motion of every texel in some frames of a sequence."""
    atlas, found = avatar.canonical.atlas, []
    for frame in (sequence.frames[index] for index in indices):
        motion = avatar.move(frame.parameters)
        axes = motion.head.head_transform[:3, :3]
        truth = atlas.positions(hidden[frame.timestep] @ axes)[atlas.valid]
        residual = motion.residual_position[atlas.valid]
        if avatar.settings.residual_frame == "world":
            residual = residual @ axes
        normals = atlas.positions(vertex_normals(motion.head.vertices, avatar.canonical.topology.faces))
        towards = frame.camera.center - atlas.positions(motion.head.vertices)
        facing = torch.nn.functional.cosine_similarity(normals, towards, dim=-1)[atlas.valid] > FACING
        found.append((truth, residual, facing))
    return Tracks(*(torch.stack(values) for values in zip(*found, strict=True)))


def region_rows(avatar: Avatar, train: Tracks, compared: Tracks) -> list[dict[str, str | float]]:
    """Rows of the regions that move, then of all."""
    truth = compared.truth - train.truth.mean(dim=0)
    residual = compared.residual - train.residual.mean(dim=0)
    moving = truth.square().sum(dim=-1).mean(dim=0).sqrt() > MOVING
    region = avatar.canonical.atlas.region[avatar.canonical.atlas.valid]
    rows = []
    for name, inside in (
        *((name, region == index) for index, name in enumerate(REGIONS)),
        ("all", region >= 0),
    ):
        seen = compared.facing & (inside & moving)
        if int((inside & moving).sum()) >= 10 and seen.any():
            rows.append({"region": name, **agreement(truth[seen], residual[seen])})
    return rows


def agreement(truth: Tensor, residual: Tensor) -> dict[str, str | float]:
    """Lengths in millimetres (root mean square), recovered shares and correlation of (S, 3) motions."""
    energy, left = truth.square().sum(dim=0), (residual - truth).square().sum(dim=0)
    shares = [
        100.0 * float(1.0 - rest / part) if part > LEAST_SHARE * energy.sum() else "none"
        for part, rest in zip(energy, left, strict=True)
    ]
    lengths = {
        "true, mm": truth,
        "residual, mm": residual,
        "error, mm": residual - truth,
    }
    return {
        **{name: 1e3 * float(values.square().sum(dim=-1).mean().sqrt()) for name, values in lengths.items()},
        "recovered, %": 100.0 * float(1.0 - left.sum() / energy.sum()),
        "sideways, %": shares[0],
        "upward, %": shares[1],
        "followed, %": 100.0 * float((residual * truth).sum() / energy.sum()),
        "correlation": float(
            (residual * truth).sum() / (energy.sum() * residual.square().sum()).sqrt().clamp(min=1e-12)
        ),
    }


def moving_pixels(
    avatar: Avatar, sequence: TrackedSequence, indices: Sequence[int], hidden: Tensor, *, resolution: int
) -> float:
    """Mean PSNR over some frames of the pixels that show what moves."""
    found = []
    for frame in (sequence.frames[index] for index in indices):
        camera = frame.camera.resized(width=resolution, height=resolution)
        rendered = avatar.render(frame.parameters, camera).image
        shown = torch.from_numpy(to_uint8(rendered.numpy())).float() / 255.0
        truth = at_size(read_image(frame.image_path, channels=3), resolution)
        where = shows_motion(avatar, frame, hidden[frame.timestep], resolution=resolution)
        if where.any():
            found.append(float(psnr_where(shown, truth, where)))
    return float(np.mean(found))


def shows_motion(avatar: Avatar, frame: Frame, displacement: Tensor, *, resolution: int) -> Tensor:
    """(H, W) bool: pixels of a frame that show a triangle which moves in it."""
    topology = avatar.canonical.topology
    camera = frame.camera.resized(width=resolution, height=resolution)
    vertices = avatar.canonical.pose(frame.parameters).vertices + displacement
    points = camera.image_points(vertices)[None]
    face = rasterize_mesh(points, topology, width=resolution, height=resolution).face[0].long()
    moves = displacement.norm(dim=1)[topology.faces.long()].mean(dim=1) > MOVING
    return (face >= 0) & moves[face.clamp(min=0)]


if __name__ == "__main__":
    sys.exit(run(main, MotionTableConfig, program="python tools/motion_table.py"))
