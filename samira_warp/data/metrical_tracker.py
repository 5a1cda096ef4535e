"""metrical-tracker's output and the INSTA datasets made of it: a checkpoint beside each picture.

    checkpoint/00001.frame   what torch.save wrote: flame (exp, shape, eyes, jaw, eyelids), opencv (R, t, K),
                             img_size
    images/00001.png         or input/; RGBA pictures bring their coverage
    transforms_train.json, transforms_test.json   INSTA's division, if there

The tracker turns the camera about a still head; its rotations are the first two rows of the matrix.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from samira_warp.data.film import Film, Intrinsics, list_film
from samira_warp.data.frames import FrameFiles
from samira_warp.data.index import FileIndex
from samira_warp.data.numbers import check_rotation, numbers, stacked
from samira_warp.data.pictures import files_of, key_of, pictures_of, stem_of
from samira_warp.data.split import Split
from samira_warp.data.track import Track, tracking_of
from samira_warp.data.tracking import Reading
from samira_warp.head.joints import ROOT
from samira_warp.io.files import read_json
from samira_warp.io.pickles import arrays_of, read_torch_archive
from samira_warp.support.errors import UserError
from samira_warp.support.faults import each

FRAMES = "checkpoint/*.frame"
"""What marks the format."""

IMAGE_FOLDERS = ("images", "image", "input")

SAME_SHAPE = 0.02
"""Share of a side by which two pictures of one shape may differ, by rounding."""

_Read = tuple[Path, dict[str, np.ndarray]]

_FLAME_SIZES = {"exp": None, "shape": None, "eyes": 12, "jaw": 6, "eyelids": 2}
_CAMERA_SHAPES = {"R": (3, 3), "t": (3,), "K": (3, 3)}


def open_metrical_tracker(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open a folder with metrical-tracker's checkpoints.

    Raises:
        UserError: A file is missing or broken, a value has a wrong shape, or no picture belongs to a
            checkpoint.
    """
    read = each(lambda path: (path, _checked(path, index.arrays(path, _read_frame))), files_of(root, FRAMES))
    read = each(lambda one: _of_one_person(*one, read[0]), read)
    paths = [path for path, _ in read]
    rows = stacked(paths[0].parent, [arrays for _, arrays in read])
    track = _track(paths[0].parent, rows)

    def intrinsics(number: int, width: int, height: int) -> Intrinsics:
        return _in_picture(rows["K"][number], rows["img_size"][number], width=width, height=height)

    film = Film(
        root=root,
        format="metrical-tracker's checkpoints (INSTA)",
        image_folders=_by_shape(root, rows["img_size"][0], index),
        mask_folders=("fg_masks", "mask", "masks"),
        names=[path.stem for path in paths],
        paths=paths,
        world_to_camera=track.world_to_camera,
        intrinsics=intrinsics,
        division=_own_division(root),
    )
    listed = list_film(film, split, index)
    doubts = [
        doubt
        for frame, number in zip(listed.listing.frames, listed.numbers, strict=True)
        if (doubt := _other_shape(frame, rows["img_size"][number])) is not None
    ]
    listing = replace(listed.listing, doubts=tuple(doubts))
    track = track.taken(listed.numbers)
    return Reading(listing, lambda template: tracking_of(track, template, listed.pose))


def _in_picture(matrix: np.ndarray, size: np.ndarray, *, width: int, height: int) -> Intrinsics:
    """The camera of a picture, whose (3, 3) matrix is that of the (height, width) picture that was tracked.

    A picture of another shape shows what the tracker cropped, nobody knows where; the middle is assumed, so
    that a focal length stays one.
    """
    tracked_height, tracked_width = size
    scale = min(width / tracked_width, height / tracked_height)
    x, y = (
        (scale, scale)
        if _is_cropped(size, width, height)
        else (width / tracked_width, height / tracked_height)
    )
    left, top = 0.5 * (width - x * tracked_width), 0.5 * (height - y * tracked_height)
    return Intrinsics(matrix[0, 0] * x, matrix[1, 1] * y, matrix[0, 2] * x + left, matrix[1, 2] * y + top)


def _is_cropped(size: np.ndarray, width: int, height: int) -> bool:
    """Whether a picture has another shape than the (height, width) one that was tracked."""
    return abs(width * size[0] - height * size[1]) > SAME_SHAPE * width * size[0]


def _by_shape(root: Path, size: np.ndarray, index: FileIndex) -> tuple[str, ...]:
    """Folders of pictures, those of the tracked shape first: the tracker leaves its crops in input/."""

    def is_other(name: str) -> bool:
        picture = next(iter(pictures_of(root / name).values()), None)
        return picture is None or _is_cropped(size, *index.picture_size(picture))

    return tuple(sorted(IMAGE_FOLDERS, key=is_other))


def _other_shape(frame: FrameFiles, size: np.ndarray) -> UserError | None:
    """The doubt in a frame whose picture is not the one that was tracked."""
    camera = frame.camera
    if not _is_cropped(size, camera.width, camera.height):
        return None
    tracked = f"{size[1]:g} x {size[0]:g}"
    expected = f"the tracker's own pictures, of the shape {tracked} (it leaves its crops in input/)"
    return UserError(frame.image_path, expected=expected, found=f"{camera.width} x {camera.height}")


def _track(path: Path, rows: dict[str, np.ndarray]) -> Track:
    """The head stands still at the origin and does not bend its neck, the camera moves."""
    still = np.zeros((len(rows["t"]), 3))
    pose = np.tile(np.eye(4), (len(still), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rows["R"], rows["t"]
    return Track(
        path=path,
        shape=rows["shape"][0],
        expression=rows["exp"],
        poses={
            ROOT: still,
            "neck": still,
            "jaw": rotation_vectors(rows["jaw"]),
            "left_eye": rotation_vectors(rows["eyes"][:, :6]),
            "right_eye": rotation_vectors(rows["eyes"][:, 6:]),
        },
        translation=still,
        world_to_camera=pose,
        eyelids=rows["eyelids"],
    )


def rotation_vectors(rows: np.ndarray) -> np.ndarray:
    """(T, 3) axis-angle of (T, 6) rotations given by the first two rows of their matrix.

    The rows are made orthonormal as in Zhou et al., "On the continuity of rotation representations in neural
    networks", 2019.
    """
    first = rows[:, :3] / np.linalg.norm(rows[:, :3], axis=1, keepdims=True)
    second = rows[:, 3:] - (first * rows[:, 3:]).sum(axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([first, second, np.cross(first, second)], axis=1)).as_rotvec()


def _read_frame(path: Path) -> dict[str, np.ndarray]:
    """The arrays of one checkpoint that matter here."""
    payload = read_torch_archive(path)
    size = arrays_of(path, payload, ("img_size",))
    for group in ("flame", "opencv"):
        if group not in payload:
            raise UserError(path, expected=f"the key {group}", found="none")
    flame = payload["flame"]
    if isinstance(flame, dict):
        flame = {"eyelids": [0.0, 0.0], **flame}  # early versions of the tracker have none
    return (
        size
        | arrays_of(path, flame, tuple(_FLAME_SIZES))
        | arrays_of(path, payload["opencv"], tuple(_CAMERA_SHAPES))
    )


def _checked(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same arrays without their axes of one frame, of the right shapes."""
    checked = {
        key: numbers(f"{path}: flame.{key}", arrays[key], None if size is None else (size,))
        for key, size in _FLAME_SIZES.items()
    }
    for key, shape in _CAMERA_SHAPES.items():
        checked[key] = numbers(f"{path}: opencv.{key}", arrays[key], shape)
    check_rotation(f"{path}: opencv.R", checked["R"])
    checked["img_size"] = numbers(f"{path}: img_size", arrays["img_size"], (2,))
    for place, value in (
        ("img_size", checked["img_size"].min()),
        ("opencv.K", checked["K"].diagonal()[:2].min()),
    ):
        if value <= 0:
            raise UserError(f"{path}: {place}", expected="positive numbers", found=value)
    for key in ("jaw", "eyes"):
        if (np.linalg.norm(checked[key].reshape(-1, 3), axis=1) < 1e-6).any():
            raise UserError(f"{path}: flame.{key}", expected="two rows of a rotation", found="a row of zeros")
    return checked


def _of_one_person(path: Path, arrays: dict[str, np.ndarray], first: _Read) -> _Read:
    """The same file and arrays, if their identity is the first one's.

    Coefficients are of order 1: float32 text round trips lose 1e-5.
    """
    shape, wanted = arrays["shape"], first[1]["shape"]
    if shape.shape != wanted.shape or not np.allclose(shape, wanted, atol=1e-5):
        raise UserError(f"{path}: flame.shape", expected=f"the identity of {first[0].name}", found="another")
    return path, arrays


def _own_division(root: Path) -> tuple[set[str], set[str]] | None:
    """Names of the frames that train and that test, from INSTA's lists; None where they are not there."""
    paths = [root / f"transforms_{part}.json" for part in ("train", "test")]
    if not all(path.is_file() for path in paths):
        return None
    parts = []
    for path in paths:
        frames = read_json(path).get("frames")
        if not isinstance(frames, list) or not all(
            isinstance(frame, dict) and isinstance(frame.get("file_path"), str) for frame in frames
        ):
            raise UserError(
                path, expected="a list 'frames' of objects with a file_path", found="something else"
            )
        parts.append({key_of(stem_of(frame["file_path"])) for frame in frames})
    return parts[0], parts[1]
