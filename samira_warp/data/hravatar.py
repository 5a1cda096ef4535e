"""HRAvatar's datasets.

tracked_params.json       a head four times as large; or tracked_params_v2.json, in metres
    shapecode, intrinsics [fx, fy, cx, cy], and for each picture's name (with or without suffix):
    expcode, fullposecode (15), world_mat, and optionally translation (3) and eyelids (2)
image/ or images/, mask/, albedo/
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from samira_warp.data.deca_json import intrinsics_of, pose_in_metres, pose_of, poses_by_joint
from samira_warp.data.film import Film, list_film
from samira_warp.data.index import FileIndex
from samira_warp.data.numbers import numbers, stacked
from samira_warp.data.pictures import stem_of
from samira_warp.data.split import Split
from samira_warp.data.track import Track, tracking_of
from samira_warp.data.tracking import Reading
from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.support.faults import each

SCALES = {"tracked_params.json": 4.0, "tracked_params_v2.json": 1.0}
"""Size of the head in each version of the file, in metres; the first that is there counts, as in HRAvatar."""


def open_hravatar(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open a folder of HRAvatar's.

    Raises:
        UserError: A key is missing, a value has a wrong shape, or no picture belongs to an entry.
    """
    path = next(root / name for name in SCALES if (root / name).is_file())
    document = read_json(path)
    entries = {
        name: entry for name, entry in document.items() if isinstance(entry, dict) and "fullposecode" in entry
    }
    if not entries:
        raise UserError(
            path, expected="an entry with fullposecode for each picture", found=f"{len(document)} others"
        )
    read = each(lambda name: (name, _row(path, name, entries[name], document, SCALES[path.name])), entries)
    rows = stacked(path, [row for _, row in read])
    track = Track(
        path=path,
        shape=numbers(f"{path}: shapecode", document.get("shapecode")),
        expression=rows["expression"],
        poses=poses_by_joint(rows["pose"]),
        translation=rows["translation"],
        world_to_camera=rows["world_to_camera"],
        eyelids=rows["eyelids"],
    )
    film = Film(
        root=root,
        format=f"HRAvatar's {path.name}",
        image_folders=("image", "images"),
        mask_folders=("mask", "masks", "fg_masks"),
        names=[stem_of(name) for name, _ in read],
        paths=[path] * len(read),
        world_to_camera=track.world_to_camera,
        intrinsics=intrinsics_of(f"{path}: intrinsics", document.get("intrinsics"), pixels_of=None),
    )
    listed = list_film(film, split, index)
    track = track.taken(listed.numbers)
    return Reading(listed.listing, lambda template: tracking_of(track, template, listed.pose))


def _row(
    path: Path, name: str, entry: dict[str, Any], document: dict[str, Any], scale: float
) -> dict[str, np.ndarray]:
    place = f"{path}: {name}"
    return {
        "expression": numbers(f"{place}: expcode", entry.get("expcode")),
        "pose": pose_of(f"{place}: fullposecode", entry["fullposecode"]),
        "translation": numbers(f"{place}: translation", entry.get("translation", [0.0] * 3), (3,)),
        "eyelids": numbers(f"{place}: eyelids", entry.get("eyelids", [0.0] * 2), (2,)),
        "world_to_camera": pose_in_metres(
            f"{place}: world_mat", entry.get("world_mat", document.get("world_mat")), scale=scale
        ),
    }
