"""What was read of a dataset's files, kept in the user's cache folder.

A long sequence then opens in seconds the second time. Every file is looked at on every opening; what was read
of it counts only while its size, its time and the time of its last change are the same. Archives and copies
set a file's time as they like; the system alone sets that of the change.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from samira_warp.io.files import cache_folder
from samira_warp.io.images import image_size

FEWEST_FILES = 1000
"""Fewer are read again as fast as an index of them."""

_VERSION = 2
_LARGE = 4096
_MOST_LARGE = 64
"""Arrays of more numbers than `_LARGE` (offsets of all vertices) are kept once for the files that share them;
a dataset with more than `_MOST_LARGE` of them has one for each frame, and those are left in their files."""


class Stamp(NamedTuple):
    """By which a file is known to be unchanged."""

    time: int
    changed: int
    size: int


class _Row(NamedTuple):
    stamp: Stamp
    layout: str
    numbers: np.ndarray


class FileIndex:
    """Reads files of one dataset, or remembers what they held.

    Args:
        root: The dataset's folder, which the index is kept by.
    """

    def __init__(self, root: Path) -> None:
        self._prefix = f"{root}{os.sep}"
        name = hashlib.blake2b(
            str(root.resolve()).encode("utf-8", "surrogateescape"), digest_size=16
        ).hexdigest()
        self._path = cache_folder() / "index" / f"{name}.npz"
        self._sizes: dict[str, tuple[Stamp, tuple[int, int]]] = {}
        self._rows: dict[str, _Row] = {}
        self._large: dict[str, np.ndarray] = {}
        self._changed = False
        self._load()

    def picture_size(self, path: Path) -> tuple[int, int]:
        """(width, height) of a picture, as `image_size`."""
        name, stamp = self._name(path), _stamp(path)
        known = self._sizes.get(name)
        if known is not None and known[0] == stamp:
            return known[1]
        size = image_size(path)
        if stamp is not None:
            self._sizes[name] = stamp, size
            self._changed = True
        return size

    def arrays(self, path: Path, read: Callable[[Path], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """What ``read`` gives for a file of a frame's parameters, as float32.

        Arrays of anything but numbers stay as they are.
        """
        name, stamp = self._name(path), _stamp(path)
        known = self._rows.get(name)
        if known is not None and known.stamp == stamp:
            return self._unpack(known)
        arrays = read(path)
        if stamp is None or any(array.dtype.kind not in "fiu" for array in arrays.values()):
            return arrays
        self._rows[name] = self._pack(stamp, arrays)
        self._changed = True
        return self._unpack(self._rows[name])

    def save(self) -> None:
        """Keep the index; where its folder cannot be written, the next opening reads the files again."""
        if not self._changed or max(len(self._sizes), len(self._rows)) < FEWEST_FILES:
            return
        fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open("wb") as file:
                arrays: dict[str, Any] = self._to_arrays()
                np.savez(file, **arrays)
            fresh.replace(self._path)
        except OSError:
            with contextlib.suppress(OSError):
                fresh.unlink()

    def _name(self, path: Path) -> str:
        """Within the folder, however that was named."""
        return str(path).removeprefix(self._prefix)

    def _pack(self, stamp: Stamp, arrays: dict[str, np.ndarray]) -> _Row:
        layout, numbers = [], []
        for key, array in arrays.items():
            with np.errstate(over="ignore"):  # what becomes infinite is found where it is used
                values = np.asarray(array, np.float32)
            digest = None
            if values.size > _LARGE:
                digest = hashlib.blake2b(values.tobytes(), digest_size=16).hexdigest()
                self._large.setdefault(digest, values)
            else:
                numbers.append(values.ravel())
            layout.append([key, list(values.shape), digest])
        return _Row(stamp, json.dumps(layout), np.concatenate([*numbers, np.empty(0, np.float32)]))

    def _unpack(self, row: _Row) -> dict[str, np.ndarray]:
        arrays, start = {}, 0
        for key, shape, digest in _parts(row.layout):
            if digest is not None:
                arrays[key] = self._large[digest]
                continue
            end = start + math.prod(shape)
            arrays[key] = row.numbers[start:end].reshape(shape)
            start = end
        return arrays

    def _to_arrays(self) -> dict[str, np.ndarray]:
        """Rows are stacked by layout; the layouts of a dataset's files are mostly one."""
        rows = {} if len(self._large) > _MOST_LARGE else self._rows
        content = {"version": np.asarray(_VERSION), "sizes/names": np.array(list(self._sizes), np.str_)}
        content["sizes/values"] = np.array(
            [(*stamp, *size) for stamp, size in self._sizes.values()], np.int64
        ).reshape(-1, 5)
        for number, layout in enumerate(dict.fromkeys(row.layout for row in rows.values())):
            members = {name: row for name, row in rows.items() if row.layout == layout}
            content[f"rows/{number}/layout"] = np.asarray(layout)
            content[f"rows/{number}/names"] = np.array(list(members), np.str_)
            content[f"rows/{number}/stamps"] = np.array([row.stamp for row in members.values()], np.int64)
            content[f"rows/{number}/numbers"] = np.stack([row.numbers for row in members.values()])
        if rows:
            content |= {f"large/{digest}": array for digest, array in self._large.items()}
        return content

    def _load(self) -> None:
        """Take up what is kept; what cannot be read counts as none."""
        try:
            with np.load(self._path, allow_pickle=False) as archive:
                content = dict(archive)
            if content["version"] != _VERSION:
                return
            for name, (*stamp, width, height) in zip(
                content["sizes/names"].tolist(), content["sizes/values"].tolist(), strict=True
            ):
                self._sizes[name] = Stamp(*stamp), (width, height)
            self._large = {
                key.removeprefix("large/"): array
                for key, array in content.items()
                if key.startswith("large/")
            }
            number = 0
            while f"rows/{number}/layout" in content:
                layout, names, stamps, numbers = (
                    content[f"rows/{number}/{part}"] for part in ("layout", "names", "stamps", "numbers")
                )
                for name, stamp, row in zip(names.tolist(), stamps.tolist(), numbers, strict=True):
                    self._rows[name] = _Row(Stamp(*stamp), str(layout), row)
                number += 1
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
            self._sizes, self._rows, self._large = {}, {}, {}


@functools.cache
def _parts(layout: str) -> list[tuple[str, list[int], str | None]]:
    """Key, shape and, of a large array, digest of each array of a row."""
    return json.loads(layout)


def _stamp(path: Path) -> Stamp | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return Stamp(status.st_mtime_ns, status.st_ctime_ns, status.st_size)
