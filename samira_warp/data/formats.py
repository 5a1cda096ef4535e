"""Which kinds of dataset folders there are, and how each is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from samira_warp.data.hravatar import SCALES, open_hravatar
from samira_warp.data.imavatar import PARAMETERS, open_imavatar
from samira_warp.data.index import FileIndex
from samira_warp.data.metrical_tracker import FRAMES, open_metrical_tracker
from samira_warp.data.pictures import files_of
from samira_warp.data.split import Split
from samira_warp.data.tracking import Reading
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.data.vhap_heads import open_vhap
from samira_warp.data.vhap_tracked import TRACKED, open_vhap_tracked
from samira_warp.support.errors import UserError


class Format(NamedTuple):
    """A kind of folder."""

    name: str
    marks: tuple[str, ...]
    """Patterns of files, one of which a folder of this kind has."""
    open: Callable[[Path, Split, FileIndex], Reading]


FORMATS = (
    Format("VHAP export", (CANONICAL_FILE,), open_vhap),
    Format("VHAP's tracked parameters", (TRACKED,), open_vhap_tracked),
    Format("HRAvatar", tuple(SCALES), open_hravatar),
    Format("IMavatar, FLARE", (PARAMETERS,), open_imavatar),
    Format("metrical-tracker, INSTA", (FRAMES,), open_metrical_tracker),
)
"""The first whose mark is there is what a folder is."""


def recognise(root: Path) -> Format:
    """What a folder is.

    Raises:
        UserError: The folder is missing or of no known format; the message names the marks, and folders
            within it that have one.
    """
    if not root.is_dir():
        raise UserError(
            root, expected="a dataset's folder", found="a file" if root.exists() else "no such folder"
        )
    known = _format_of(root)
    if known is not None:
        return known
    if (root / "flame_param").is_dir():
        raise UserError(
            root / CANONICAL_FILE, expected="the canonical parameters of a VHAP export", found="no such file"
        )
    marks = "; ".join(f"{' or '.join(kind.marks)} ({kind.name})" for kind in FORMATS)
    within = [path.name for path in sorted(root.iterdir()) if path.is_dir() and _format_of(path) is not None]
    hint = f"none of them, but the folder {within[0]} in it is a dataset" if within else "none of them"
    raise UserError(root, expected=f"a dataset, known by one of {marks}", found=hint)


def _format_of(root: Path) -> Format | None:
    return next((kind for kind in FORMATS if any(files_of(root, mark) for mark in kind.marks)), None)
