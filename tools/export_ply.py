"""Export one frame of an avatar as a 3DGS .ply that any splat viewer opens.

usage: python tools/export_ply.py --avatar DIR [--frame N] --out FILE.ply

Gaussians are in world space, after binding and residual. Only the standard columns of 3D Gaussian splatting
are written: position, normal, spherical harmonics of degree 3 (degree 0 holds the sRGB-encoded albedo, the
rest is zero), opacity, scale and rotation.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from samira_warp.avatar import Avatar, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.head import FrameParameters
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

SH_DEGREE_0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi)): viewers show 0.5 + SH_DEGREE_0 * f_dc."""

SH_REST = 45
"""Coefficients of degrees 1 to 3 for three channels; some viewers refuse files without them."""


@dataclass(frozen=True)
class ExportConfig:
    """Export one frame of an avatar as a 3DGS .ply that any splat viewer opens."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """The .ply file to write."""
    frame: int = 0
    """Which of the avatar's own frames, test frames first."""


def main(config: ExportConfig) -> None:
    """Load, move, write."""
    folder = find_avatar(config.avatar)
    avatar = Avatar.load(folder)
    frames = read_frames(folder)
    if not 0 <= config.frame < len(frames):
        raise UserError("--frame", expected=f"0 to {len(frames) - 1}", found=config.frame)
    if config.out.suffix != ".ply":
        raise UserError(
            config.out, expected="a file name ending in .ply", found=config.out.suffix or "no suffix"
        )
    if not config.out.parent.is_dir():
        raise UserError(config.out.parent, expected="an existing folder", found="no such folder")
    with torch.no_grad():
        columns = splat_columns(avatar, frames[config.frame].parameters)
    table = np.empty(len(avatar.gaussians), dtype=[(name, "f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    PlyData([PlyElement.describe(table, "vertex")]).write(str(config.out))


def splat_columns(avatar: Avatar, parameters: FrameParameters) -> dict[str, np.ndarray]:
    """The columns of a 3DGS file in their order, each (N,)."""
    moved = avatar.move(parameters).gaussians
    display = avatar.display(avatar.gaussians.albedo)
    zeros = torch.zeros(len(moved.means), SH_REST)
    groups = {
        ("x", "y", "z"): moved.means,
        ("nx", "ny", "nz"): moved.normals,
        tuple(f"f_dc_{i}" for i in range(3)): (display - 0.5) / SH_DEGREE_0,
        tuple(f"f_rest_{i}" for i in range(SH_REST)): zeros,
        ("opacity",): avatar.gaussians.opacity_logits[:, None],
        tuple(f"scale_{i}" for i in range(3)): moved.scales.log(),
        tuple(f"rot_{i}" for i in range(4)): moved.quaternions,
    }
    return {
        name: values[:, column].cpu().numpy()
        for names, values in groups.items()
        for column, name in enumerate(names)
    }


if __name__ == "__main__":
    sys.exit(run(main, ExportConfig, program="python tools/export_ply.py"))
