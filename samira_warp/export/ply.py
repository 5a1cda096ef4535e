"""A .ply of 3D Gaussian splatting, with the standard columns and no others.

Position, normal, spherical harmonics of degree 0, which hold the colour, opacity, scale and rotation, all
float32, little-endian: what else a .ply may hold, most readers of splats refuse or misread. A colour does not
change with the view here, so there are no higher degrees; readers tell the degree by the columns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

from samira_warp.export.axes import down_forward
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import Splats, frame_splats

COMMENTS = (
    "axes: x to the head's left, y down, z to the back",
    "unit: metre",
    "SplatRenderMode: mip",
)
"""What no column says. The last one, Brush's word, is read by splat-transform, too: whoever widens a splat
for the picture's pixels takes from its opacity what that adds, as the avatar was trained."""


def write(source: ExportSource, path: Path) -> str:
    """Write the chosen frame."""
    (frame,) = source.chosen
    splats = frame_splats(source, frame)
    write_ply(splats, path, frame=frame.name)
    return f"{len(splats.means):,} splats of frame {frame.name}"


def write_ply(splats: Splats, path: Path, *, frame: str) -> None:
    """Write the splats of a frame of that name where ``path`` says."""
    columns = splat_columns(down_forward(splats))
    table = np.empty(len(splats.means), dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    vertex = PlyElement.describe(table, "vertex")
    PlyData([vertex], byte_order="<", comments=[*COMMENTS, f"frame: {frame}"]).write(str(path))


def splat_columns(splats: Splats) -> dict[str, np.ndarray]:
    """The columns of the file in their order, each (N,)."""
    groups = {
        ("x", "y", "z"): splats.means,
        ("nx", "ny", "nz"): splats.normals,
        tuple(f"f_dc_{i}" for i in range(3)): splats.harmonics,
        ("opacity",): splats.opacity_logits[:, None],
        tuple(f"scale_{i}" for i in range(3)): splats.scales.log(),
        tuple(f"rot_{i}" for i in range(4)): splats.quaternions,
    }
    return {
        name: values[:, column].cpu().numpy()
        for names, values in groups.items()
        for column, name in enumerate(names)
    }
