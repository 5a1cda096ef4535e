"""VHAP's own result beside the pictures that it tracked, before the export.

    tracked_flame_params_30.npz   the last epoch counts: shape, and T rows of expr, translation, rotation,
                                  neck_pose, jaw_pose, eyes_pose (other joints than FLAME's as pose_<joint>);
                                  timestep_id, focal_length (a share of the longer side), perhaps
                                  static_offset and dynamic_offset; its n_processed_frames is where tracking
                                  began, and says nothing
    images/00000.jpg              the frames of the film, named by timestep_id or in its order
    alpha_maps/00000.jpg          their coverage

Films of one camera alone: only for them does VHAP find the camera itself, which then stands at (0, 0, 1) and
looks along -z.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from samira_warp.data.film import Film, Intrinsics, list_film
from samira_warp.data.index import FileIndex
from samira_warp.data.numbers import numbers
from samira_warp.data.pictures import files_of, first_folder, key_of, natural, pictures_of
from samira_warp.data.split import Split
from samira_warp.data.track import Track, tracking_of
from samira_warp.data.tracking import Reading, Tracking
from samira_warp.data.vhap_parameters import checked, load_parameters, offsets, read_poses
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of

TRACKED = "tracked_flame_params*.npz"
"""What marks the format."""

_IMAGE_FOLDERS = ("images", "image")


def open_vhap_tracked(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open a folder with VHAP's tracked parameters.

    Raises:
        UserError: A key is missing, a value has a wrong shape, the film was taken by more than one camera, or
            pictures are missing.
    """
    path = max(files_of(root, TRACKED), key=lambda path: natural(path.name))
    arrays = load_parameters(path, also=("focal_length", "timestep_id"))
    if "focal_length" not in arrays:
        found = "none: the cameras were calibrated. Export the dataset with vhap.export_as_nerf_dataset"
        raise UserError(path, expected="the key focal_length", found=found)
    focal = float(numbers(f"{path}: focal_length", arrays["focal_length"], (1,))[0])
    if focal <= 0:
        raise UserError(f"{path}: focal_length", expected="a positive number", found=focal)
    track = _track(path, arrays)
    names = _names(root, path, arrays, len(track.expression))

    def intrinsics(_: int, width: int, height: int) -> Intrinsics:
        return Intrinsics(focal * max(width, height), focal * max(width, height), 0.5 * width, 0.5 * height)

    film = Film(
        root=root,
        format="VHAP's tracked parameters",
        image_folders=_IMAGE_FOLDERS,
        mask_folders=("alpha_maps", "alpha_map", "fg_masks"),
        names=names,
        paths=[path] * len(names),
        world_to_camera=track.world_to_camera,
        intrinsics=intrinsics,
    )
    listed = list_film(film, split, index)

    def tracking(template: HeadTemplate) -> Tracking:
        poses = read_poses(path, arrays, template, count=len(names))
        posed = replace(track, poses={name: pose.astype(np.float64) for name, pose in poses.items()})
        found = tracking_of(posed.taken(listed.numbers), template, listed.pose)
        return _with_offsets(found, path, arrays, template, listed.numbers)

    return Reading(listed.listing, tracking)


def _track(path: Path, arrays: dict[str, np.ndarray]) -> Track:
    """All timesteps without their poses, which are the template's matter.

    The head is moved to the origin and the camera with it, as VHAP's export does.
    """
    found = arrays.get("expr", np.empty(0))
    every = len(found) if found.ndim == 2 else 0
    expression, translation = (
        values.astype(np.float64)
        for values in all_of(
            partial(checked, path, arrays, "expr", (every, found.shape[-1] if found.ndim else 0)),
            partial(checked, path, arrays, "translation", (every, 3)),
        )
    )
    centre = translation.mean(axis=0)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = pose[:3, :3] @ (centre - [0.0, 0.0, 1.0])
    return Track(
        path=path,
        shape=numbers(f"{path}: shape", arrays.get("shape")),
        expression=expression,
        poses={},
        translation=translation - centre,
        world_to_camera=np.tile(pose, (len(expression), 1, 1)),
    )


def _names(root: Path, path: Path, arrays: dict[str, np.ndarray], count: int) -> list[str]:
    """Stems of the pictures: the timesteps' own names, or where they are others the pictures in order."""
    pictures = pictures_of(first_folder(root, _IMAGE_FOLDERS) or root / _IMAGE_FOLDERS[0])
    names = [str(name) for name in np.ravel(arrays["timestep_id"])] if "timestep_id" in arrays else []
    if len(names) == count and any(key_of(name) in pictures for name in names):
        return names
    if len(pictures) != count:
        raise UserError(
            path,
            expected=f"{count} pictures, one a tracked timestep",
            found=f"{len(pictures)} in {_IMAGE_FOLDERS[0]}",
        )
    return sorted(pictures, key=natural)


def _with_offsets(
    tracking: Tracking, path: Path, arrays: dict[str, np.ndarray], template: HeadTemplate, rows: list[int]
) -> Tracking:
    """The heads with their offsets, where VHAP found any.

    Its camera stands still, so that they cannot move it.
    """
    vertices, static, parameters = len(template.v_template), None, tracking.parameters
    if "static_offset" in arrays:
        static = torch.from_numpy(offsets(path, arrays, "static_offset", 1, vertices)[0])
    if "dynamic_offset" in arrays:
        dynamic = torch.from_numpy(offsets(path, arrays, "dynamic_offset", len(arrays["expr"]), vertices))
        parameters = replace(parameters, dynamic_offset=dynamic[rows])
    return replace(tracking, static_offset=static, parameters=parameters)
