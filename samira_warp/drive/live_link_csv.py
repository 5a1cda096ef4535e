"""Recordings of Epic's Live Link Face: a CSV file a take, a row a frame, a column a shape or an angle."""

from __future__ import annotations

import csv
import itertools
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from samira_warp.drive.arkit import NUMBER_OF, SHAPES, FaceSignal, known_shape, turn_of
from samira_warp.support.errors import UserError

TIMECODE, COUNT = "timecode", "blendshapecount"
"""Columns that are neither shapes nor angles, in lower case."""

ANGLES = (
    *("HeadYaw", "HeadPitch", "HeadRoll"),
    *("LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll"),
    *("RightEyeYaw", "RightEyePitch", "RightEyeRoll"),
)
"""The other columns, radians: yaw turns to the person's left, pitch up, roll to the right shoulder."""

USUAL_RATE = 60
"""Frames a second of the app, unless it is told otherwise."""

RATES = (24, 25, 30, USUAL_RATE)
"""What timecodes count in."""

_TIMECODE = re.compile(r"(\d+):(\d+):(\d+):(\d+(?:\.\d+)?)")


class Recording(NamedTuple):
    """A take.

    Attributes:
        frames: Those that show a face, at least one, in order; seconds from the first row.
        numbers: Of their rows, from 0.
        rows: How many there are, with and without a face.
    """

    frames: tuple[FaceSignal, ...]
    numbers: tuple[int, ...]
    rows: int


def read_recording(path: Path) -> Recording:
    """Read a take.

    Columns are found by name, in any order and spelling; what is missing is zero, what is not known is left
    out, and both are said. A row whose count of shapes is 0 shows no face.

    Raises:
        UserError: The file is missing, is no such table, has no row with a face in it, or a value is no
            number; the message names the line and the column.
    """
    header, rows = _table(path)
    columns = _columns(path, header)
    seconds = _seconds([row[columns[TIMECODE]] if TIMECODE in columns else "" for row in rows], path)
    counts = [row[columns[COUNT]].strip() if COUNT in columns else "" for row in rows]
    seen = [number for number, count in enumerate(counts) if count != "0"]
    if not seen:
        raise UserError(path, expected="rows with a face in them", found=f"none among {len(rows)}")
    frames = tuple(_signal(path, rows[number], number, columns, seconds[number]) for number in seen)
    return Recording(frames, tuple(seen), len(rows))


def signal_of(values: dict[str, float], seconds: float) -> FaceSignal:
    """A frame of values by the names of `SHAPES` and `ANGLES`; those that are not there are zero.

    Head and eyes are told where any of their angles is.
    """
    shapes = np.array([values.get(name, 0.0) for name in SHAPES])

    def turn(of: str) -> np.ndarray | None:
        if not any(f"{of}{way}" in values for way in ("Yaw", "Pitch", "Roll")):
            return None
        yaw, pitch, roll = (values.get(f"{of}{way}", 0.0) for way in ("Yaw", "Pitch", "Roll"))
        return turn_of(-pitch, yaw, roll)

    left, right = turn("LeftEye"), turn("RightEye")
    eyes = None if left is None or right is None else np.stack([left, right])
    return FaceSignal(seconds, shapes, turn("Head"), eyes)


def _table(path: Path) -> tuple[list[str], list[list[str]]]:
    """The header, and at least one row."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise UserError(path, expected="a recording of Live Link Face (.csv)", found=found)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as fault:
        raise UserError(path, expected="a table of text, comma-separated", found=fault) from fault
    if not lines:
        raise UserError(
            path, expected="a header and rows, as Live Link Face writes them", found="an empty file"
        )
    header, *rows = lines
    if not rows:
        raise UserError(path, expected="a row for every frame", found="a header alone")
    return header, rows


def _columns(path: Path, header: Sequence[str]) -> dict[str, int]:
    """Columns of `SHAPES`, `ANGLES`, the timecode and the count by name, as far as there are any."""
    angles = {name.lower(): name for name in ANGLES}
    columns: dict[str, int] = {}
    unknown = []
    for number, title in enumerate(header):
        plain = title.strip().lower()
        name = plain if plain in (TIMECODE, COUNT) else angles.get(plain) or known_shape(title)
        if name is None:
            unknown.append(title.strip() or f"column {number + 1}")
        elif name in columns:
            raise UserError(path, expected="one column of each name", found=f"two of {title.strip()}")
        else:
            columns[name] = number
    if not any(name in columns for name in SHAPES):
        expected = f"columns of ARKit's shapes, such as {', '.join(SHAPES[:2])}"
        raise UserError(path, expected=expected, found=f"{', '.join(unknown[:4]) or 'none of them'}")
    if unknown:
        print(f"note: {path}: columns that are not known are left out: {', '.join(unknown)}", file=sys.stderr)
    missing = [name for name in (*SHAPES, *ANGLES) if name not in columns]
    if missing:
        print(f"note: {path}: what has no column is taken as 0: {', '.join(missing)}", file=sys.stderr)
    return columns


def _signal(path: Path, row: list[str], number: int, columns: dict[str, int], seconds: float) -> FaceSignal:
    values = {}
    for name, column in columns.items():
        if name in NUMBER_OF or name in ANGLES:
            text = row[column] if column < len(row) else ""
            try:
                values[name] = float(text)
            except ValueError:
                values[name] = math.nan
            if not math.isfinite(values[name]):
                where = f"{path}: row {number + 1}, {name}"
                raise UserError(where, expected="a number", found=repr(text) if text.strip() else "nothing")
    return signal_of(values, seconds)


def _seconds(timecodes: list[str], path: Path) -> list[float]:
    """When each row was, from the first; by its number where timecodes do not tell.

    HH:MM:SS:FF.FFF counts frames after the last colon.
    """
    found = [_TIMECODE.fullmatch(text.strip()) for text in timecodes]
    if all(found):
        parts = [tuple(float(part) for part in match.groups()) for match in found if match]
        rate = _rate([frame for *_, frame in parts], whole=len({second for _, _, second, _ in parts}) > 2)
        times = [3600 * hour + 60 * minute + second + frame / rate for hour, minute, second, frame in parts]
        times = [(time - times[0]) % 86400.0 for time in times]  # a take may go on past midnight
        if all(before < after for before, after in itertools.pairwise(times)):
            return times
    rate = USUAL_RATE
    print(f"note: {path}: no timecodes that rise; {rate} frames a second are taken for it", file=sys.stderr)
    return [number / rate for number in range(len(timecodes))]


def _rate(frames: list[float], *, whole: bool) -> int:
    """What timecodes count in: of `RATES` the least above their frames, where a whole second is seen."""
    return next((rate for rate in RATES if max(frames) < rate), USUAL_RATE) if whole else USUAL_RATE
