"""The frames that an avatar was made from, kept with it, so that it renders without its dataset."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from samira_warp.avatar.storage.description import find_avatar, read_description
from samira_warp.avatar.storage.older import FORMAT, frames_of_version
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.io.files import save_tensors
from samira_warp.support.errors import UserError

FRAMES_FILE = "frames.safetensors"


class DrivingFrame(NamedTuple):
    """What drives an avatar in one frame.

    Attributes:
        name: Stem of the output files.
        parameters: The head's pose and expression.
        camera: The view.
        part: "train" or "test".
    """

    name: str
    parameters: FrameParameters
    camera: Camera
    part: str


def write_frames(folder: Path, frames: list[DrivingFrame]) -> None:
    """Write frames, at least one, into an existing avatar folder of the newest version.

    Raises:
        UserError: The folder is no avatar's, or of an older version.
    """
    version = read_description(folder).version
    if version != FORMAT:
        raise UserError(
            folder, expected=f"an avatar of format {FORMAT}, saved again", found=f"format {version}"
        )
    parameters = FrameParameters.stack([frame.parameters.to("cpu") for frame in frames])
    tensors = {
        "translation": parameters.translation,
        "rotations": parameters.rotations,
        "expression": parameters.expression,
    }
    if parameters.dynamic_offset is not None:
        tensors["dynamic_offset"] = parameters.dynamic_offset
    cameras = [frame.camera for frame in frames]
    tensors["world_to_camera"] = torch.stack([camera.world_to_camera.cpu() for camera in cameras])
    intrinsics = [
        [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height] for camera in cameras
    ]
    tensors["intrinsics"] = torch.tensor(intrinsics, dtype=torch.float64)
    names = {
        "names": "\n".join(frame.name for frame in frames),
        "parts": "\n".join(frame.part for frame in frames),
    }
    save_tensors(tensors, folder / FRAMES_FILE, metadata=names)


def read_frames(folder: str | Path) -> list[DrivingFrame]:
    """Read the frames of an avatar folder, or of the run folder that it is in, on the CPU; test frames first.

    Raises:
        UserError: The file is missing or broken, or the folder of an unknown version.
    """
    folder = find_avatar(Path(folder))
    path, version = folder / FRAMES_FILE, read_description(folder).version
    try:
        with safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        tensors = frames_of_version(tensors, version)
        parameters = FrameParameters(
            translation=tensors["translation"],
            rotations=tensors["rotations"],
            expression=tensors["expression"],
            dynamic_offset=tensors.get("dynamic_offset"),
        )
        names, parts = metadata["names"].split("\n"), metadata["parts"].split("\n")
        return [
            DrivingFrame(name, parameters[row], _camera(tensors, row), part)
            for row, (name, part) in enumerate(zip(names, parts, strict=True))
        ]
    except (OSError, SafetensorError, KeyError, ValueError, IndexError) as error:
        raise UserError(path, expected="the avatar's frames", found=error) from error


def _camera(tensors: dict[str, Tensor], row: int) -> Camera:
    fx, fy, cx, cy, width, height = tensors["intrinsics"][row].tolist()
    return Camera(tensors["world_to_camera"][row], fx, fy, cx, cy, int(width), int(height))
