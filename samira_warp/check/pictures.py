"""Faults of pictures that only decoding them shows, and pictures that nothing names."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from samira_warp.check.findings import Finding, finding_of
from samira_warp.data import FrameFiles, Listing
from samira_warp.data.mattes import read_matte
from samira_warp.data.pictures import key_of, natural, pictures_of, stem_of
from samira_warp.data.pixels import unmatted_albedos
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.io.files import read_json
from samira_warp.io.images import read_on_white, read_rgba
from samira_warp.support.errors import UserError

Decoded = TypeVar("Decoded")

_GIVE_MATTES = "give these frames masks, or pictures with an alpha channel"

_BATCH = 64
"""Frames that are handed to the threads at once: what waits for its turn costs memory."""


def undecodable(frames: Iterable[FrameFiles]) -> list[Finding]:
    """Pictures, masks and albedos that cannot be decoded, and masks that are empty.

    Progress goes to standard error.
    """
    frames = list(frames)
    found: list[Finding] = []
    with (
        ThreadPoolExecutor(os.cpu_count()) as threads,
        tqdm(total=len(frames), desc="pictures", unit="frame", leave=False) as bar,
    ):
        for first in range(0, len(frames), _BATCH):
            batch = frames[first : first + _BATCH]
            for findings in threads.map(_decoded, batch):
                found += findings
            bar.update(len(batch))
    return found


def unlisted(listing: Listing) -> list[Finding]:
    """Pictures of a VHAP export that none of its lists names; readers of other formats note theirs.

    Only lists that can be read are looked at: what is wrong with the others has been said.
    """
    if not (listing.root / CANONICAL_FILE).is_file():
        return []
    named = {key_of(frame.name) for frame in listing.frames}
    for path in listing.root.glob("transforms*.json"):
        try:
            named |= {key_of(stem_of(entry["file_path"])) for entry in read_json(path)["frames"]}
        except (ValueError, KeyError, TypeError):
            continue
    found = []
    for folder in sorted({frame.image_path.parent for frame in listing.frames}):
        lost = sorted(set(_names(folder)) - named, key=natural)
        if lost:
            count = f"{len(lost)} pictures that no list names, the first is {lost[0]}"
            found.append(
                Finding(
                    "warning",
                    str(folder),
                    "frames with parameters for all pictures",
                    count,
                    "export again to use them, or take them away",
                )
            )
    return found


def unused_albedos(listing: Listing) -> list[Finding]:
    """Albedo files that training compares nothing with, for want of a matte, by their folder."""
    try:
        unmatted = unmatted_albedos(listing.frames)
    except UserError:  # what cannot be opened has been said
        return []
    files = [frame.albedo_path for frame in unmatted if frame.albedo_path is not None]
    return [
        Finding(
            "warning",
            str(folder),
            "a matte for every frame with an albedo, which is compared inside it",
            f"neither a mask nor an alpha channel for {len(names)} of the albedo files, the first is "
            f"{names[0]}, so that they are not used",
            _GIVE_MATTES,
        )
        for folder in sorted({path.parent for path in files})
        if (names := [path.name for path in files if path.parent == folder])
    ]


def _names(folder: Path) -> Iterable[str]:
    try:
        return pictures_of(folder)
    except UserError:  # two pictures of one name: which of them is used, the lists say
        return ()


def _decoded(frame: FrameFiles) -> list[Finding]:
    """What is wrong with one frame's files."""
    found: list[Finding] = []

    def decode(read: Callable[[Path], Decoded], path: Path) -> Decoded | None:
        try:
            return read(path)
        except UserError as fault:
            found.append(finding_of(fault))
            return None

    picture = decode(read_rgba, frame.image_path)
    if frame.albedo_path is not None:
        decode(read_on_white, frame.albedo_path)
    if frame.mask_path is not None:
        matte = decode(read_matte, frame.mask_path)
    else:
        matte = None if picture is None else picture[1]
    return found if matte is None else [*found, *_of_matte(frame, matte)]


def _of_matte(frame: FrameFiles, matte: np.ndarray) -> list[Finding]:
    """What is wrong with a matte that covers nothing, or everything."""
    found, least, most = [], matte.min(), matte.max()
    if most < 0.5:
        remedy = "make the mask again, or take the frame out of the lists"
        place, covered = str(frame.mask_path or frame.image_path), f"at most {most:.0%} of coverage"
        found.append(Finding("warning", place, "a head that is covered", covered, remedy))
    if least >= 1.0 and frame.albedo_path is not None:
        wanted = "a matte for every frame with an albedo, which is compared inside it"
        covered = "one that covers everything, so that the albedo is not used"
        found.append(Finding("warning", str(frame.albedo_path), wanted, covered, _GIVE_MATTES))
    return found
