"""The listing of a VHAP export (the input of GaussianAvatars): transforms, pictures, masks and cameras.

Every file that the listing names is looked for, and every picture's header is compared with the camera,
before anything is returned.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.film import check_picture, check_shape
from samira_warp.data.frames import FrameFiles, Listing, listing_of
from samira_warp.data.index import FileIndex
from samira_warp.data.lens import KEYS, OTHERS, lens_of
from samira_warp.data.numbers import check_rotation
from samira_warp.data.pictures import key_of, pictures_of, with_slashes
from samira_warp.data.split import Split
from samira_warp.geometry.camera import Camera
from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of, each

CANONICAL_FILE = "canonical_flame_param.npz"
"""Its presence is how GaussianAvatars knows the format, and so do we."""


def list_vhap(root: Path, split: Split, index: FileIndex) -> Listing:
    """List a VHAP export's frames and divide them.

    The dataset's own split reads transforms_train.json and transforms_test.json (validation views belong to
    neither part); any other reads transforms.json.

    Args:
        root: The export's folder.
        split: How to divide the frames.
        index: Remembers the pictures' sizes.

    Raises:
        UserError: A file or key is missing, a value has a wrong type or shape, an image's size is not its
            camera's, or a part is empty.
    """
    reader = _Reader(root, index)
    trains: list[bool] | None = None
    if split.kind != "dataset":
        frames = reader.transforms("transforms.json")
    else:
        train, test = all_of(
            *(partial(reader.transforms, f"transforms_{part}.json") for part in ("train", "test"))
        )
        shared = {frame.image_path for frame in train} & {frame.image_path for frame in test}
        if shared:
            raise UserError(
                root / "transforms_test.json",
                expected="frames that are not trained on",
                found=f"{min(shared).stem} in both",
            )
        frames = train + test
        trains = [True] * len(train) + [False] * len(test)
    return listing_of(root, split, frames, format="VHAP export", trains=trains, notes=_lens_notes(frames))


def _lens_notes(frames: list[FrameFiles]) -> tuple[str, ...]:
    """What a user should know of the lenses, if any bends pictures."""
    bent = [(frame.lens.reach(frame.camera), frame) for frame in frames if frame.lens is not None]
    if not bent:
        return ()
    reach, frame = max(bent, key=lambda one: one[0])
    of = f"{len(bent)} pictures are distorted by their lens, by up to {reach:.1f} pixels in {frame.name}"
    return (f"{of}: they are made straight as they are read",)


class _Reader:
    """One export: what all entries of its lists share."""

    def __init__(self, root: Path, index: FileIndex) -> None:
        self.root = root
        self.index = index
        self._folders: dict[Path, dict[str, Path]] = {}

    def transforms(self, name: str) -> list[FrameFiles]:
        """The frames of one transforms file, each checked."""
        path = self.root / name
        if not path.is_file():
            raise UserError(path, expected="the dataset's list of frames", found="no such file")
        document = read_json(path)
        if not isinstance(document.get("frames"), list):
            raise UserError(path, expected="an object with a list 'frames'", found="none")
        if not document["frames"]:
            raise UserError(path, expected="at least one frame", found="an empty list")

        def files(number: int) -> FrameFiles:
            return _Entry(
                path, number, _with_shared_values(path, number, document["frames"][number], document)
            ).files(self)

        return each(files, range(len(document["frames"])))

    def picture(self, path: Path) -> Path | None:
        """The picture at a path, or else the one beside it by another suffix or spelling of an accent."""
        if path.is_file():
            return path
        if path.parent not in self._folders:
            self._folders[path.parent] = pictures_of(path.parent)
        folder = self._folders[path.parent]
        return folder.get(key_of(path.stem)) or folder.get(key_of(path.name))

    def albedo_of(self, image_path: Path) -> Path | None:
        """The albedo of a picture: the dataset's own, or its recording's, beside its pictures' folder."""
        for folder in (self.root / "albedo", image_path.parent.parent / "albedo"):
            if folder not in self._folders:
                self._folders[folder] = pictures_of(folder)
            if key_of(image_path.stem) in self._folders[folder]:
                return self._folders[folder][key_of(image_path.stem)]
        return None


def _with_shared_values(path: Path, index: int, frame: object, document: dict[str, Any]) -> dict[str, Any]:
    """A frame's values; a camera that it does not state itself is the one at the top of the file."""
    if not isinstance(frame, dict):
        raise UserError(path, expected=f"an object as frames[{index}]", found=type(frame).__name__)
    # a focal length of the file's must not stand beside a field of view of the frame's own
    states_focal = "fl_x" in frame or "camera_angle_x" in frame
    shared = ["w", "h", "cx", "cy", "camera_model", "is_fisheye", *KEYS, *OTHERS]
    if not states_focal:
        shared += ["fl_x", "fl_y", "camera_angle_x"]
    return {**{key: document[key] for key in shared if key in document}, **frame}


class _Entry:
    """One entry of a transforms file, with the place to blame for what is wrong in it."""

    def __init__(self, path: Path, index: int, values: dict[str, Any]) -> None:
        self.path = path
        self.index = index
        self.values = values

    def files(self, reader: _Reader) -> FrameFiles:
        """The entry's files, all there and of the camera's size, and its camera."""
        image_path, mask_path, parameters_path, timestep, camera = all_of(
            lambda: self._picture(reader, "file_path"),
            lambda: self._picture(reader, "fg_mask_path") if self.values.get("fg_mask_path") else None,
            lambda: self._file(reader.root, "flame_param_path"),
            lambda: self._whole("timestep_index"),
            self.camera,
        )
        lens = lens_of(f"{self.path}: frames[{self.index}]", self.values, camera)
        albedo_path = reader.albedo_of(image_path)
        others = [path for path in (mask_path, albedo_path) if path is not None]
        checks = [partial(check_picture, image_path), *(partial(check_shape, path) for path in others)]
        all_of(*(partial(check, camera, reader.index, said_by=self.path.name) for check in checks))
        return FrameFiles(
            image_path.stem, timestep, image_path, mask_path, albedo_path, parameters_path, camera, lens
        )

    def camera(self) -> Camera:
        """The pinhole camera.

        Without fl_x the field of view gives the focal length, without cx the centre is the frame's.
        """
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

    def _world_to_camera(self) -> Tensor:
        """(4, 4) float32: the inverse of the file's camera-to-world, OpenGL's axes turned to OpenCV's."""
        values = self._value("transform_matrix")
        try:
            camera_to_world = np.array(values if isinstance(values, list) else "none", dtype=np.float64)
        except (TypeError, ValueError) as fault:
            raise self._fault("a 4 x 4 matrix of numbers as transform_matrix", "something else") from fault
        if camera_to_world.shape != (4, 4):
            raise self._fault("transform_matrix of shape (4, 4)", camera_to_world.shape)
        if not np.isfinite(camera_to_world).all():
            raise self._fault("finite numbers in transform_matrix", camera_to_world.tolist())
        check_rotation(f"{self.path}: frames[{self.index}]: transform_matrix", camera_to_world[:3, :3])
        camera_to_world[:, 1:3] *= -1.0
        return torch.from_numpy(np.linalg.inv(camera_to_world).astype(np.float32))

    def _file(self, root: Path, key: str) -> Path:
        value = self._value(key)
        if not isinstance(value, str):
            raise self._fault(f"{key} to be a path", repr(value))
        path = _path(root, value)
        if not path.is_file():
            raise UserError(
                path,
                expected=f"the file that {self.path.name} names as {key} of frames[{self.index}]",
                found="no such file",
            )
        return path

    def _picture(self, reader: _Reader, key: str) -> Path:
        value = self.values.get(key)
        picture = reader.picture(_path(reader.root, value)) if isinstance(value, str) else None
        return picture or self._file(reader.root, key)

    def _whole(self, key: str, *, above: float = -math.inf) -> int:
        value = self._number(key, above=above)
        if value != int(value):
            raise self._fault(f"{key} to be a whole number", value)
        return int(value)

    def _number(self, key: str, *, above: float = -math.inf) -> float:
        value = self._value(key)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
            or value <= above
        ):
            raise self._fault(f"{key} to be a {'positive' if above == 0 else 'finite'} number", repr(value))
        return value

    def _value(self, key: str) -> Any:
        if key not in self.values:
            raise self._fault(f"the key {key}", f"only {', '.join(sorted(self.values))}")
        return self.values[key]

    def _fault(self, expected: str, found: object) -> UserError:
        return UserError(f"{self.path}: frames[{self.index}]", expected=expected, found=found)


def _path(root: Path, value: str) -> Path:
    """A file as a list names it, on whatever system that was written."""
    path = root / value
    return path if path.exists() else root / with_slashes(value)
