"""IMavatar's datasets, which PointAvatar, FLARE and SplattingAvatar read as well.

    flame_params.json   intrinsics [fx, fy, cx, cy], shape_params,
                        frames [file_path "./image/1", world_mat (3 x 4), expression, pose (15)]
    image/, mask/       pictures 1.png, 2.png, ...

The head is four times as large as in metres, the camera looks along -z, and fx is negative.
"""

from __future__ import annotations

from pathlib import Path

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

PARAMETERS = "flame_params.json"
"""What marks the format."""

SCALE = 4.0
"""Size of the head, in metres."""

PIXELS_OF = 512
"""Early files give the intrinsics in pixels of pictures this large."""


def open_imavatar(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open one sequence of IMavatar's.

    Raises:
        UserError: A key is missing, a value has a wrong shape, or no picture belongs to a frame.
    """
    path = root / PARAMETERS
    document = read_json(path)
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise UserError(path, expected="a list 'frames' of tracked frames", found="none")
    read = each(lambda number: _row(f"{path}: frames[{number}]", frames[number]), range(len(frames)))
    rows = stacked(path, [row for _, row in read])
    track = Track(
        path=path,
        shape=numbers(f"{path}: shape_params", document.get("shape_params")),
        expression=rows["expression"],
        poses=poses_by_joint(rows["pose"]),
        translation=np.zeros((len(read), 3)),
        world_to_camera=rows["world_to_camera"],
    )
    film = Film(
        root=root,
        format=f"IMavatar's {PARAMETERS}",
        image_folders=("image", "images"),
        mask_folders=("mask", "masks", "fg_masks"),
        names=[name for name, _ in read],
        paths=[path] * len(read),
        world_to_camera=track.world_to_camera,
        intrinsics=intrinsics_of(f"{path}: intrinsics", document.get("intrinsics"), pixels_of=PIXELS_OF),
    )
    listed = list_film(film, split, index)
    track = track.taken(listed.numbers)
    return Reading(listed.listing, lambda template: tracking_of(track, template, listed.pose))


def _row(place: str, frame: object) -> tuple[str, dict[str, np.ndarray]]:
    """The name of one frame's picture, and what was tracked in it."""
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise UserError(place, expected="an object with a file_path", found=type(frame).__name__)
    return stem_of(frame["file_path"]), {
        "expression": numbers(f"{place}: expression", frame.get("expression")),
        "pose": pose_of(f"{place}: pose", frame.get("pose")),
        "world_to_camera": pose_in_metres(f"{place}: world_mat", frame.get("world_mat"), scale=SCALE),
    }
