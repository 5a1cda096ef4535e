"""Other people's .npz archives: the arrays that are asked for, by name, and nothing else of them."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile

from samira_warp.support.errors import UserError

_PLAIN = "an .npz of plain arrays"

_UNREADABLE = (
    ValueError,
    TypeError,
    AttributeError,
    OSError,
    EOFError,
    RuntimeError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
"""What numpy and zipfile raise at files that are broken, encrypted, or of another kind, and at pickles."""


def read_npz(path: Path, *, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """The arrays of an archive whose names are wanted; nothing is unpickled.

    Entries that nobody wants are not even opened: trackers leave pickled objects beside their arrays.

    Raises:
        UserError: The file is no archive, or an entry that is wanted cannot be read; the message names it.
    """
    place, arrays = f"{path}", {}
    try:
        with _opened(path) as archive:
            for name in filter(wanted, archive.files):
                place = f"{path}: {name}"
                arrays[name] = _array(archive, name)
    except _UNREADABLE as fault:
        found = f"unreadable content ({fault or type(fault).__name__})"
        raise UserError(place, expected=_PLAIN, found=found) from fault
    return arrays


def names_of(path: Path) -> tuple[str, ...]:
    """The names of an archive's arrays, none of which is read.

    Raises:
        UserError: The file is no archive.
    """
    try:
        with _opened(path) as archive:
            return tuple(archive.files)
    except _UNREADABLE as fault:
        found = f"unreadable content ({fault or type(fault).__name__})"
        raise UserError(path, expected=_PLAIN, found=found) from fault


def _opened(path: Path) -> NpzFile:
    archive = np.load(path, allow_pickle=False)
    if not isinstance(archive, NpzFile):
        raise ValueError("a single array")
    return archive


def _array(archive: NpzFile, name: str) -> np.ndarray:
    array = archive[name]
    if not isinstance(array, np.ndarray):  # numpy hands out the bytes of what is no array
        raise ValueError("no array")
    return array
