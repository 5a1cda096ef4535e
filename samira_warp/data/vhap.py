"""The listing of a VHAP export (the input of GaussianAvatars): transforms, pictures, masks and cameras.

Every file that the listing names is looked for, and every picture's header is compared with the camera, before anything is returned.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch

from samira_warp.camera import Camera
from samira_warp.data.frames import FrameFiles, Listing
from samira_warp.data.split import Split, divide_timesteps
from samira_warp.errors import UserError
from samira_warp.images import image_size

CANONICAL_FILE = "canonical_flame_param.npz"
"""Its presence is how GaussianAvatars knows the format, and so do we."""


def list_vhap(root: Path, split: Split) -> Listing:
    """List a VHAP export's frames and divide them.

    The dataset's own split reads transforms_train.json and transforms_test.json (validation views belong to neither part);
    any other reads transforms.json.

    Args:
        root: The export's folder.
        split: How to divide the frames.

    Raises:
        UserError: A file or key is missing, a value has a wrong type or shape, an image's size is not its camera's, or a part is empty.
    """
    if split.kind != "dataset":
        frames = _read_transforms(root, "transforms.json")
        train_steps, _ = divide_timesteps(split, [frame.timestep for frame in frames])
        is_train = [frame.timestep in train_steps for frame in frames]
    else:
        train, test = (_read_transforms(root, f"transforms_{part}.json") for part in ("train", "test"))
        shared = {frame.name for frame in train} & {frame.name for frame in test}
        if shared:
            raise UserError(root / "transforms_test.json", expected="frames that are not trained on", found=f"{min(shared)} in both")
        frames = train + test
        is_train = [True] * len(train) + [False] * len(test)
    _check_names(root, frames)
    ordered = sorted(zip(frames, is_train, strict=True), key=lambda entry: (entry[0].timestep, entry[0].name))
    return Listing(
        root=root,
        split=split,
        frames=tuple(frame for frame, _ in ordered),
        train=tuple(index for index, (_, trains) in enumerate(ordered) if trains),
        test=tuple(index for index, (_, trains) in enumerate(ordered) if not trains),
    )


def _check_size(path: Path, size: tuple[int, int], camera: Camera) -> None:
    """Raise UserError unless a picture of ``size`` (width, height) is its camera's."""
    if size != (camera.width, camera.height):
        raise UserError(path, expected=f"{camera.width} x {camera.height} pixels, the camera's size", found=f"{size[0]} x {size[1]}")


def _check_names(root: Path, frames: list[FrameFiles]) -> None:
    """Outputs are named by the image's stem: two frames of one name would overwrite each other."""
    seen: dict[str, Path] = {}
    for frame in frames:
        if frame.name in seen:
            raise UserError(root, expected="image names that differ", found=f"{seen[frame.name]} and {frame.image_path}")
        seen[frame.name] = frame.image_path


def _read_transforms(root: Path, name: str) -> list[FrameFiles]:
    """The frames of one transforms file, each checked."""
    path = root / name
    if not path.is_file():
        raise UserError(path, expected="the dataset's list of frames", found="no such file")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as fault:
        raise UserError(path, expected="JSON", found=fault) from fault
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise UserError(path, expected="an object with a list 'frames'", found="none")
    if not document["frames"]:
        raise UserError(path, expected="at least one frame", found="an empty list")
    return [
        _Entry(path, index, _with_shared_values(path, index, frame, document)).files(root) for index, frame in enumerate(document["frames"])
    ]


def _with_shared_values(path: Path, index: int, frame: object, document: dict[str, Any]) -> dict[str, Any]:
    """A frame's values; a camera that it does not state itself is the one at the top of the file."""
    if not isinstance(frame, dict):
        raise UserError(path, expected=f"an object as frames[{index}]", found=type(frame).__name__)
    # a focal length of the file's must not stand beside a field of view of the frame's own
    states_focal = "fl_x" in frame or "camera_angle_x" in frame
    shared = ("w", "h", "cx", "cy") if states_focal else ("w", "h", "cx", "cy", "fl_x", "fl_y", "camera_angle_x")
    return {**{key: document[key] for key in shared if key in document}, **frame}


class _Entry:
    """One entry of a transforms file, with the place to blame for what is wrong in it."""

    def __init__(self, path: Path, index: int, values: dict[str, Any]) -> None:
        self.path = path
        self.index = index
        self.values = values

    def files(self, root: Path) -> FrameFiles:
        """The entry's files, all there and of the camera's size, and its camera."""
        image_path = self._file(root, "file_path")
        mask_path = self._file(root, "fg_mask_path") if self.values.get("fg_mask_path") else None
        albedo_path = root / "albedo" / f"{image_path.stem}.png"
        camera = self.camera()
        frame = FrameFiles(
            name=image_path.stem,
            timestep=self._whole("timestep_index"),
            image_path=image_path,
            mask_path=mask_path,
            albedo_path=albedo_path if albedo_path.is_file() else None,
            parameters_path=self._file(root, "flame_param_path"),
            camera=camera,
        )
        for picture in (frame.image_path, frame.mask_path, frame.albedo_path):
            if picture is not None and (size := image_size(picture)) != (camera.width, camera.height):
                raise UserError(
                    picture, expected=f"{camera.width} x {camera.height} pixels as {self.path.name} says", found="{} x {}".format(*size)
                )
        return frame

    def camera(self) -> Camera:
        """The pinhole camera; without fl_x the field of view gives the focal length, without cx the centre is the frame's."""
        width, height = self._whole("w", above=0), self._whole("h", above=0)
        if "fl_x" in self.values:
            fx = self._number("fl_x", above=0)
            fy = self._number("fl_y", above=0) if "fl_y" in self.values else fx
        else:
            angle = self._number("camera_angle_x", above=0)
            if angle >= math.pi:
                raise self._fault("camera_angle_x below pi radians", angle)
            fx = fy = 0.5 * width / math.tan(0.5 * angle)
        cx = self._number("cx") if "cx" in self.values else 0.5 * width
        cy = self._number("cy") if "cy" in self.values else 0.5 * height
        return Camera(self._world_to_camera(), fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)

    def _world_to_camera(self) -> torch.Tensor:
        """(4, 4) float32: the file's OpenGL camera-to-world with y and z turned to OpenCV's axes, then inverted."""
        values = self._value("transform_matrix")
        try:
            camera_to_world = torch.tensor(values, dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError) as fault:
            raise self._fault("a 4 x 4 matrix of numbers as transform_matrix", "something else") from fault
        if camera_to_world.shape != (4, 4):
            raise self._fault("transform_matrix of shape (4, 4)", tuple(camera_to_world.shape))
        if not camera_to_world.isfinite().all():
            raise self._fault("finite numbers in transform_matrix", camera_to_world.tolist())
        rotation = camera_to_world[:3, :3]
        # 1e-3 lets pass matrices that were written with four decimals
        if not torch.allclose(rotation.T @ rotation, torch.eye(3, dtype=torch.float64), atol=1e-3) or torch.det(rotation) < 0:
            raise self._fault("a rotation in transform_matrix", rotation.tolist())
        camera_to_world[:, 1:3] *= -1.0
        return torch.linalg.inv(camera_to_world).float()

    def _file(self, root: Path, key: str) -> Path:
        value = self._value(key)
        if not isinstance(value, str):
            raise self._fault(f"{key} to be a path", repr(value))
        path = root / value
        if not path.is_file():
            raise UserError(path, expected=f"the file that {self.path.name} names as {key} of frames[{self.index}]", found="no such file")
        return path

    def _whole(self, key: str, *, above: float = -math.inf) -> int:
        value = self._number(key, above=above)
        if value != int(value):
            raise self._fault(f"{key} to be a whole number", value)
        return int(value)

    def _number(self, key: str, *, above: float = -math.inf) -> float:
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value <= above:
            raise self._fault(f"{key} to be a {'positive' if above == 0 else 'finite'} number", repr(value))
        return value

    def _value(self, key: str) -> Any:
        if key not in self.values:
            raise self._fault(f"the key {key}", f"only {', '.join(sorted(self.values))}")
        return self.values[key]

    def _fault(self, expected: str, found: object) -> UserError:
        return UserError(f"{self.path}: frames[{self.index}]", expected=expected, found=found)
