"""Mattes without a build: a small network looks at the person, and the picture's own edges sharpen it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tqdm import tqdm

from samira_warp.io.images import read_image, to_uint8
from samira_warp.prepare.frames import clear_unfinished, write_whole
from samira_warp.prepare.matting import CHUNK, WARM_UP
from samira_warp.vision.faces import FaceTrack
from samira_warp.vision.mattes import CoarseMatte, refine, segment
from samira_warp.vision.mesh import square_about
from samira_warp.vision.runtime import Network


def write_cut_mattes(network: Network, frames: dict[str, Path], track: FaceTrack, folder: Path) -> None:
    """Write the mattes that are not there yet, named as their frames.

    The network's mattes are steadied by those of the frames before; they begin afresh after a while, so that
    an interrupted run goes on to the same mattes.

    Raises:
        UserError: A frame cannot be read.
        OSError: A matte cannot be written.
    """
    names = sorted(frames)
    folder.mkdir(parents=True, exist_ok=True)
    clear_unfinished(folder)
    with tqdm(total=len(names), desc="mattes", unit="frame", dynamic_ncols=True) as bar:
        for first in range(0, len(names), CHUNK):
            chunk = range(first, min(first + CHUNK, len(names)))
            if not all((folder / frames[names[number]].name).exists() for number in chunk):
                before = range(max(first - WARM_UP, 0), first)
                _write_chunk(network, [frames[name] for name in names], track, before, chunk, folder, bar)
            else:
                bar.update(len(chunk))


def _write_chunk(
    network: Network,
    paths: list[Path],
    track: FaceTrack,
    before: range,
    chunk: range,
    folder: Path,
    bar: tqdm,
) -> None:
    coarse: CoarseMatte | None = None
    for number in (*before, *chunk):
        picture = to_uint8(read_image(paths[number], channels=3))
        face = square_about(track.landmarks[number]) if track.seen[number] else None
        coarse = segment(network, picture, face, coarse)
        if number not in chunk:
            continue
        if not (folder / paths[number].name).exists():
            write_whole(folder / paths[number].name, _matte(picture, coarse))
        bar.update()


def _matte(picture: np.ndarray, coarse: CoarseMatte) -> np.ndarray:
    return refine(picture, coarse).clip(0.0, 1.0)
