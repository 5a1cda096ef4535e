"""Picture files of a folder, found by name alone: any usual format, upper or lower case, any alphabet."""

from __future__ import annotations

import os
import re
import unicodedata
from pathlib import Path

from samira_warp.support.errors import UserError

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")


def key_of(name: str) -> str:
    """A stem as pictures and parameters are matched by it.

    File systems spell accents in one or two characters.
    """
    return unicodedata.normalize("NFC", name)


def stem_of(name: str) -> str:
    """A name without folders and a picture's suffix; other dots belong to it."""
    path = Path(with_slashes(name))
    return path.stem if path.suffix.lower() in SUFFIXES else path.name


def with_slashes(name: str) -> str:
    """A path as lists written on Windows name it, in the way that is understood everywhere."""
    return name.replace("\\", "/")


def is_hidden(path: Path) -> bool:
    """Whether a file is the system's own: archives made on macOS bring a ._NAME beside every NAME."""
    return path.name.startswith(".")


def files_of(root: Path, pattern: str) -> list[Path]:
    """Files of a pattern, sorted by path, without the hidden ones."""
    return sorted(path for path in root.glob(pattern) if not is_hidden(path))


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts numbers within names by value: 2 before 10."""
    return tuple(
        (1, int(part), "") if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", name)
    )


def pictures_of(folder: Path) -> dict[str, Path]:
    """Pictures of a folder by the key of their stem; empty where the folder is not there.

    Raises:
        UserError: Two pictures differ in their format alone.
    """
    found: dict[str, Path] = {}
    if not folder.is_dir():
        return found
    with os.scandir(folder) as entries:
        names = sorted(entry.name for entry in entries if not entry.name.startswith("."))
    for name in names:
        stem, suffix = os.path.splitext(name)
        if suffix.lower() not in SUFFIXES:
            continue
        key = key_of(stem)
        if key in found:
            raise UserError(
                folder / name, expected="one picture of a name", found=f"{found[key].name} as well"
            )
        found[key] = folder / name
    return found


def first_folder(root: Path, names: tuple[str, ...]) -> Path | None:
    """The first of some folders that is there."""
    return next((root / name for name in names if (root / name).is_dir()), None)
