"""What the header of a Radiance picture (.hdr) says of its pixels.

Lines of the form NAME=value, then an empty line, then the resolution, such as -Y 512 +X 1024: the outer axis
first, X to the right and Y upwards, each with the sign in which it runs (Ward, "Radiance File Formats").
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from samira_warp.support.errors import UserError

_ORIENTATIONS = {
    ("-Y", "+X"): 1,
    ("-Y", "-X"): 2,
    ("+Y", "-X"): 3,
    ("+Y", "+X"): 4,
    ("+X", "-Y"): 5,
    ("-X", "-Y"): 6,
    ("-X", "+Y"): 7,
    ("+X", "+Y"): 8,
}
"""EXIF's number of each order of pixels."""

_LONGEST = 1 << 20
"""Bytes of a header that are read: far more than any has."""


@dataclass(frozen=True)
class RadianceHeader:
    """A header, as far as it bears on the light.

    Attributes:
        gain: (3,) float64: red, green and blue were multiplied by it; the product of all EXPOSURE and
            COLORCORR lines.
        primaries: CIE x and y of red, green, blue and white; None where they are not stated.
        gamma: Of the pixels; 1 is linear.
    """

    gain: np.ndarray
    primaries: tuple[float, ...] | None
    gamma: float


def read_radiance_header(path: Path) -> RadianceHeader:
    """Read the header of a file that is known to be a Radiance picture.

    Raises:
        UserError: A line that bears on the light does not hold the numbers that it should.
    """
    variables, _ = _read(path)
    gain, primaries, gamma = np.ones(3), None, 1.0
    for line in variables:
        # Indented lines are the headers of the pictures that this one was made of.
        name, _, value = line.partition("=")
        if name == "EXPOSURE":
            gain = gain * _factors(path, line, value, count=1)
        elif name == "COLORCORR":
            gain = gain * _factors(path, line, value, count=3)
        elif name == "GAMMA":
            gamma = float(_factors(path, line, value, count=1)[0])
        elif name == "PRIMARIES":
            numbers = _numbers(path, line, value, count=8)
            primaries = tuple(numbers.tolist()) if numbers.any() else None  # Photoshop writes eight zeros
    return RadianceHeader(gain, primaries, gamma)


def read_orientation(path: Path) -> int:
    """EXIF's number for the order of the pixels in a file that is known to be a Radiance picture."""
    words = _read(path)[1].split()
    return _ORIENTATIONS.get((words[0], words[2]), 1) if len(words) == 4 else 1


def _read(path: Path) -> tuple[list[str], str]:
    """The lines of a header up to the empty one, and the one after it, of the resolution."""
    with path.open("rb") as file:
        lines = file.read(_LONGEST).decode("latin-1").replace("\r", "").split("\n")
    end = lines.index("") if "" in lines else len(lines) - 1
    return lines[:end], "".join(lines[end + 1 : end + 2])


def _numbers(path: Path, line: str, value: str, *, count: int) -> np.ndarray:
    try:
        numbers = np.array(value.split(), np.float64)
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise UserError(path, expected=f"{count} numbers in its header's line", found=repr(line.strip()))
    return numbers


def _factors(path: Path, line: str, value: str, *, count: int) -> np.ndarray:
    numbers = _numbers(path, line, value, count=count)
    if (numbers <= 0).any():
        raise UserError(path, expected="factors above 0 in its header", found=repr(line.strip()))
    return numbers
