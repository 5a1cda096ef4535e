"""A folder of numbered .ply files, one a frame, as players of splats read them."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from tqdm import tqdm

from samira_warp.export.ply import write_ply
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import frame_splats
from samira_warp.io.files import whole_file

_NUMBERED = re.compile(r"frame_\d+\.ply")


def write(source: ExportSource, folder: Path) -> str:
    """Write the chosen frames as frame_0000.ply and on, each whole or not at all."""
    names = [f"frame_{number:04d}.ply" for number in range(len(source.chosen))]
    stay = sorted(path.name for path in folder.iterdir() if _NUMBERED.fullmatch(path.name))
    stay = [name for name in stay if name not in names]
    if stay:
        print(f"note: {folder} keeps {len(stay)} of an earlier sequence, such as {stay[0]}", file=sys.stderr)
    frames = tqdm(source.chosen, unit="frame", dynamic_ncols=True)
    for name, frame in zip(names, frames, strict=True):
        with whole_file(folder / name) as fresh:
            write_ply(frame_splats(source, frame), fresh, frame=frame.name)
    return f"{len(names)} frames of {len(source.avatar.gaussians):,} splats"
