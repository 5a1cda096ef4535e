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


VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".3gp", ".mts")
"""Files that `samira_warp.prepare` makes a dataset of."""


def recognise(root: Path) -> Format:
    """What a folder is.

    Raises:
        UserError: The folder is missing or of no known format; the message says what is there instead, and
            names the marks and folders within it that have one.
    """
    if not root.is_dir():
        raise UserError(root, expected="a dataset's folder", found=_what_it_is(root))
    known = _format_of(root)
    if known is not None:
        return known
    if (root / "flame_param").is_dir():
        raise UserError(
            root / CANONICAL_FILE, expected="the canonical parameters of a VHAP export", found="no such file"
        )
    entries = sorted(path for path in root.iterdir() if not path.name.startswith("."))
    if not entries:
        raise UserError(root, expected="a dataset's folder", found="an empty folder")
    videos = [path for path in entries if path.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) == len(entries):
        raise UserError(root, expected="a dataset's folder", found=_a_video(videos[0]))
    marks = "; ".join(f"{' or '.join(kind.marks)} ({kind.name})" for kind in FORMATS)
    within = [path.name for path in entries if path.is_dir() and _format_of(path) is not None]
    hints = [f"the folder {name} in it is a dataset" for name in within] + list(map(_a_video, videos))
    found = f"none of them, but {hints[0]}" if hints else "none of them"
    raise UserError(root, expected=f"a dataset, known by one of {marks}", found=found)


def _what_it_is(path: Path) -> str:
    """What is there in place of a folder, and how to make a dataset of it."""
    if not path.exists():
        return "no such folder"
    return _a_video(path) if path.suffix.lower() in VIDEO_SUFFIXES else "a file"


def _a_video(path: Path) -> str:
    return f"a video: python -m samira_warp.prepare {path} --out DIR makes a dataset of it"


def _format_of(root: Path) -> Format | None:
    return next((kind for kind in FORMATS if any(files_of(root, mark) for mark in kind.marks)), None)
