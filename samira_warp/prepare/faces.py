"""Where the face is in a video: the square to keep, and what networks see in every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from samira_warp.io.files import whole_file
from samira_warp.io.images import read_image, to_uint8
from samira_warp.io.npz import read_npz
from samira_warp.prepare.crop import Box
from samira_warp.support.errors import UserError
from samira_warp.vision.cuts import find_cuts, longest_continuous
from samira_warp.vision.faces import FaceTrack, follow_faces
from samira_warp.vision.networks import FaceNetworks

ABOVE, BESIDE, BELOW = 0.55, 0.35, 0.25
"""How far a head with its hair, ears and neck goes beyond the landmarks' box, in heights and widths of it."""

LONGEST_GAP = 0.5
"""Seconds without a face that are interpolated: a hand that passes. Longer ones are left out."""

FEWEST = 2
"""Frames with a face that make a film."""


class Chosen(NamedTuple):
    """The frames of a film that are tracked.

    Attributes:
        frames: Their numbers.
        left_out: Why others are not, by number.
        notes: What should be said of the film as a whole.
    """

    frames: list[int]
    left_out: dict[int, str]
    notes: list[str]


class Found(NamedTuple):
    """What one picture shows of a head.

    Attributes:
        box: Where it is, None where there is none.
        reason: Why there is none, else "".
        alone: Whether it is the only one.
    """

    box: Box | None
    reason: str = ""
    alone: bool = True


def find_face(network: FaceNetworks, picture: np.ndarray) -> Found:
    """The head of the largest face in one picture (H, W, 3) uint8."""
    track = follow_faces([picture], network)
    if not track.seen[0]:
        return Found(None, track.reasons[0])
    low, high = track.landmarks[0, :, :2].min(axis=0), track.landmarks[0, :, :2].max(axis=0)
    width, height = high - low
    left, right = low[0] - BESIDE * width, high[0] + BESIDE * width
    top, bottom = low[1] - ABOVE * height, high[1] + BELOW * height
    return Found(Box(round(left), round(top), round(right), round(bottom)), alone=not track.notes)


def write_faces(pictures: list[Path], networks: FaceNetworks, target: Path) -> None:
    """Follow the face through a film's frames, and keep what is seen.

    Raises:
        UserError: A frame cannot be read.
        OSError: The file cannot be written.
    """

    def read() -> Iterator[np.ndarray]:
        for path in tqdm(pictures, desc="faces", unit="frame", dynamic_ncols=True):
            yield to_uint8(read_image(path, channels=3))

    track = follow_faces(read(), networks)
    arrays: dict[str, Any] = {field.name: getattr(track, field.name) for field in fields(track)}
    for name in _TEXTS:
        arrays[name] = np.asarray(arrays[name], np.str_)
    with whole_file(target) as path, path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_faces(path: Path) -> FaceTrack:
    """Read what `write_faces` wrote."""
    names = {field.name for field in fields(FaceTrack)}
    arrays: dict[str, Any] = dict(read_npz(path, wanted=names.__contains__))
    for name in _TEXTS:
        arrays[name] = tuple(map(str, arrays[name]))
    return FaceTrack(**arrays)


_TEXTS = ("reasons", "notes")
"""Fields of a `FaceTrack` that are no numbers."""


def choose_frames(video: Path, track: FaceTrack, *, rate: float) -> Chosen:
    """The longest part of a film without a cut that shows one person, without long gaps.

    Args:
        video: For what is said of it.
        track: What is seen in its frames.
        rate: Frames a second.

    Raises:
        UserError: There is hardly a face to be seen.
    """
    cuts = _cuts(track)
    part = longest_continuous(track.person, cuts)
    seen = track.seen[part]
    if seen.sum() < FEWEST:
        reasons = [reason for reason in track.reasons if reason]
        common = max(set(reasons), key=reasons.count) if reasons else "none"
        expected = f"a face in at least {FEWEST} frames"
        raise UserError(video, expected=expected, found=f"{int(seen.sum())} of {len(track.seen)}: {common}")
    notes = list(track.notes)
    if part.stop - part.start < len(track.seen) and cuts:
        many = "a cut" if len(cuts) == 1 else f"{len(cuts)} cuts"
        places = ", ".join(f"{cut / rate:.1f}" for cut in cuts[:5]) + (", ..." if len(cuts) > 5 else "")
        notes.append(
            f"{many}, at {places} s: the longest part is taken, frames {part.start} to {part.stop - 1}"
        )
    numbers = np.arange(part.start, part.stop)
    long_gaps = _long_gaps(seen, longest=max(round(LONGEST_GAP * rate), 1))
    frames = numbers[~long_gaps].tolist()
    kept = set(frames)
    left_out = {
        number: track.reasons[number] or "another part of the film"
        for number in range(len(track.seen))
        if number not in kept
    }
    return Chosen(frames, left_out, notes)


def _cuts(track: FaceTrack) -> list[int]:
    """Frames that begin another shot of a face.

    What is between two frames that show it is no part of any: a lens that is covered for a moment, or a look
    at something else, ends no shot.
    """
    seen = np.flatnonzero(track.seen)
    return [int(seen[place]) for place in find_cuts(track.colours[seen], track.landmarks[seen])]


def _long_gaps(seen: np.ndarray, *, longest: int) -> np.ndarray:
    """(N,) whether a frame is in a row of more than so many in which no face is seen."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]]).astype(int)))
    result = np.zeros(len(seen), dtype=bool)
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        result[first:end] = end - first > longest
    return result


def rows_of(track: FaceTrack, frames: list[int]) -> FaceTrack:
    """What is seen in some frames."""
    chosen = {field.name: getattr(track, field.name) for field in fields(track)}
    arrays = {name: values[frames] for name, values in chosen.items() if name not in _TEXTS}
    reasons = tuple(track.reasons[frame] for frame in frames)
    return replace(track, **arrays, reasons=reasons)
