"""The listing of a film that one camera took and a tracker followed.

Pictures, masks and cameras are found by the frames' names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.data.frames import FrameFiles, Listing, listing_of
from samira_warp.data.index import FileIndex
from samira_warp.data.pictures import first_folder, key_of, natural, pictures_of
from samira_warp.data.split import Split
from samira_warp.geometry.camera import Camera
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of, each


class Intrinsics(NamedTuple):
    """A pinhole camera's inner numbers in pixels, as in `Camera`."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class Film:
    """What a tracker's format says of a folder, before its pictures are looked at.

    Attributes:
        root: The dataset's folder.
        format: What the folder is, in words.
        image_folders: Names of folders that may hold the pictures; the first that is there does.
        mask_folders: The same for the head's coverage.
        names: Stems of the tracked frames' pictures, T in any order.
        paths: (T) the file of each frame's parameters.
        world_to_camera: (T, 4, 4) each frame's pose as tracked; the camera is held at that of the first one
            by name.
        intrinsics: Gives the camera of a frame from its number and its picture's width and height.
        division: Names of the frames that train and of those that test by the dataset's own lists, None where
            it has none.
        notes: What a user should know, a sentence each.
    """

    root: Path
    format: str
    image_folders: tuple[str, ...]
    mask_folders: tuple[str, ...]
    names: Sequence[str]
    paths: Sequence[Path]
    world_to_camera: np.ndarray
    intrinsics: Callable[[int, int, int], Intrinsics]
    division: tuple[set[str], set[str]] | None = None
    notes: tuple[str, ...] = ()


class Listed(NamedTuple):
    """A film's listing."""

    listing: Listing
    numbers: list[int]
    """The number of each of the listing's frames among the film's."""
    pose: np.ndarray
    """(4, 4) world to camera, where the camera is held: the first frame's that has a picture, however the
    frames are divided."""


def list_film(film: Film, split: Split, index: FileIndex) -> Listed:
    """List a film's frames and divide them.

    Args:
        film: The folder.
        split: How to divide the frames.
        index: Remembers the pictures' sizes.

    Raises:
        UserError: No folder of pictures is there, two tracked frames have one name, no picture belongs to a
            tracked frame, a picture cannot be read, a mask has another shape than its picture, or a part is
            empty.
    """
    matched, notes = _matched(film)
    masks = pictures_of(first_folder(film.root, film.mask_folders) or film.root / "fg_masks")
    albedos = pictures_of(film.root / "albedo")
    pose = film.world_to_camera[matched[0][0]]
    trains = None
    if film.division is not None and split.kind == "dataset":
        train, test = film.division
        matched = [(number, picture) for number, picture in matched if key_of(picture.stem) in train | test]
        trains = [key_of(picture.stem) in train for _, picture in matched]
    held = torch.from_numpy(pose.astype(np.float32))

    def files(timestep: int) -> tuple[int, FrameFiles]:
        number, picture = matched[timestep]
        width, height = index.picture_size(picture)
        camera = Camera(held, *film.intrinsics(number, width, height), width=width, height=height)
        key = key_of(picture.stem)
        frame = FrameFiles(
            picture.stem,
            timestep,
            picture,
            masks.get(key),
            albedos.get(key),
            film.paths[number],
            camera,
            None,
        )
        others = [path for path in (frame.mask_path, frame.albedo_path) if path is not None]
        all_of(*(partial(check_shape, path, camera, index, said_by=picture.name) for path in others))
        return timestep, frame

    read = each(files, range(len(matched)))
    trains = None if trains is None else [trains[timestep] for timestep, _ in read]
    frames = [frame for _, frame in read]
    listing = listing_of(
        film.root, split, frames, format=film.format, trains=trains, notes=(*film.notes, *notes)
    )
    return Listed(listing, [matched[timestep][0] for timestep, _ in read], pose)


def check_picture(path: Path, camera: Camera, index: FileIndex, *, said_by: str) -> None:
    """Raise UserError unless a picture has its camera's size."""
    size = index.picture_size(path)
    if size != (camera.width, camera.height):
        raise UserError(
            path,
            expected=f"{camera.width} x {camera.height} pixels as {said_by} says",
            found="{} x {}".format(*size),
        )


def check_shape(path: Path, camera: Camera, index: FileIndex, *, said_by: str) -> None:
    """Raise UserError unless a mask or albedo shows the camera's view, at any size.

    A pixel's rounding of one side is let pass.
    """
    width, height = index.picture_size(path)
    if abs(width * camera.height - height * camera.width) > max(width, height, camera.width, camera.height):
        wanted = f"{camera.width} x {camera.height} pixels as {said_by} says, or another size of that shape"
        raise UserError(path, expected=wanted, found=f"{width} x {height}")


def _matched(film: Film) -> tuple[list[tuple[int, Path]], tuple[str, ...]]:
    """Tracked frames with their pictures in the order of their names, and what was left out."""
    folder = first_folder(film.root, film.image_folders)
    if folder is None:
        wanted = f"a folder of pictures: {' or '.join(film.image_folders)}"
        raise UserError(film.root, expected=wanted, found="none")
    pictures = pictures_of(folder)
    keys = [key_of(name) for name in film.names]
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise UserError(
            film.paths[0], expected="tracked frames that differ in name", found=f"two named {twice}"
        )
    order = sorted(range(len(keys)), key=lambda number: natural(keys[number]))
    matched = [(number, pictures[keys[number]]) for number in order if keys[number] in pictures]
    if not matched:
        first = f"; the first tracked frame is {film.names[0]!r}" if film.names else ""
        raise UserError(
            folder, expected="pictures named as the tracked frames", found=f"none of {len(pictures)}{first}"
        )
    notes = []
    untracked, unseen = sorted(set(pictures) - set(keys), key=natural), len(keys) - len(matched)
    if untracked:
        left_out = f"{len(untracked)} pictures of {folder.name} have no tracked parameters and are left out"
        notes.append(f"{left_out}, the first is {untracked[0]}")
    if unseen:
        notes.append(f"{unseen} tracked frames have no picture in {folder.name} and are left out")
    return matched, tuple(notes)
