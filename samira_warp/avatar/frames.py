"""The frames that an avatar was made from, kept with it, so that it renders without its dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open

from samira_warp.avatar.storage import find_avatar
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.io.files import save_tensors
from samira_warp.support.errors import UserError

FRAMES_FILE = "frames.safetensors"

FIELDS = ("translation", "rotation", "neck", "jaw", "eyes", "expression")
"""What is stored of every frame's parameters, beside dynamic offsets where any frame has one; the static
offset is the avatar's own."""


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
    """Write frames into an existing avatar folder."""
    tensors = {
        name: torch.stack([getattr(frame.parameters, name).detach().cpu() for frame in frames])
        for name in FIELDS
    }
    offsets = [frame.parameters.dynamic_offset for frame in frames]
    known = next((offset.cpu() for offset in offsets if offset is not None), None)
    if known is not None:
        tensors["dynamic_offset"] = torch.stack(
            [torch.zeros_like(known) if offset is None else offset.cpu() for offset in offsets]
        )
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
        UserError: The file is missing or broken.
    """
    path = find_avatar(Path(folder)) / FRAMES_FILE
    try:
        with safe_open(path, framework="pt") as file:
            metadata: dict[str, Any] = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        names, parts = metadata["names"].split("\n"), metadata["parts"].split("\n")
        return [
            _frame(name, part, tensors, row)
            for row, (name, part) in enumerate(zip(names, parts, strict=True))
        ]
    except (OSError, SafetensorError, KeyError, ValueError, IndexError) as error:
        raise UserError(path, expected="the avatar's frames", found=error) from error


def _frame(name: str, part: str, tensors: dict[str, torch.Tensor], row: int) -> DrivingFrame:
    fx, fy, cx, cy, width, height = tensors["intrinsics"][row].tolist()
    camera = Camera(tensors["world_to_camera"][row], fx, fy, cx, cy, int(width), int(height))
    dynamic = tensors["dynamic_offset"][row] if "dynamic_offset" in tensors else None
    parameters = FrameParameters(**{field: tensors[field][row] for field in FIELDS}, dynamic_offset=dynamic)
    return DrivingFrame(name, parameters, camera, part)
