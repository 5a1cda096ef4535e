"""The lists of frames of a VHAP export: which picture, which camera, which parameters."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from samira_warp.geometry.camera import Camera

Entry = dict[str, object]
"""One frame of a transforms file."""


def entry(name: str, camera: Camera, *, timestep: int, camera_index: int = 0) -> Entry:
    """A frame.

    Args:
        name: Its picture's, without suffix.
        camera: The view.
        timestep: Which parameters it shows.
        camera_index: Which of the moment's cameras.
    """
    camera_to_world = torch.linalg.inv(camera.world_to_camera.double())
    camera_to_world[:, 1:3] *= -1.0
    return {
        "timestep_index": timestep,
        "timestep_index_original": timestep,
        "timestep_id": f"{timestep:05d}",
        "camera_index": camera_index,
        "camera_id": f"{camera_index:02d}",
        **_intrinsics(camera),
        "transform_matrix": (camera_to_world + 0.0).tolist(),
        "file_path": f"images/{name}.png",
        "fg_mask_path": f"fg_masks/{name}.png",
        "flame_param_path": f"flame_param/{timestep:05d}.npz",
    }


def write_transforms(folder: Path, camera: Camera, parts: Mapping[str, Sequence[Entry]]) -> None:
    """Write transforms.json and transforms_PART.json.

    Args:
        folder: Where to.
        camera: The view whose lens and size all frames share.
        parts: Frames by part: those of transforms.json are all of them, in the parts' order.
    """
    every = [one for part in parts.values() for one in part]
    for name, frames in {"": every, **{f"_{part}": frames for part, frames in parts.items()}}.items():
        (folder / f"transforms{name}.json").write_text(_listing(frames, camera), encoding="utf-8")


def _listing(frames: Sequence[Entry], camera: Camera) -> str:
    steps, cameras = ([frame[key] for frame in frames] for key in ("timestep_index", "camera_index"))
    unique = sorted({int(str(index)) for index in cameras}) or [0]
    values = {**_intrinsics(camera), "timestep_indices": steps, "camera_indices": unique, "frames": frames}
    return json.dumps(values, indent=1)


def _intrinsics(camera: Camera) -> dict[str, float]:
    return {
        "cx": camera.cx,
        "cy": camera.cy,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "h": camera.height,
        "w": camera.width,
        "camera_angle_x": 2.0 * math.atan(0.5 * camera.width / camera.fx),
        "camera_angle_y": 2.0 * math.atan(0.5 * camera.height / camera.fy),
    }
