"""What a run trains on, and what makes it where it is not there yet."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from samira_warp.data.subjects import made_subject
from samira_warp.train.begun import Begun

PREPARED_FOLDER = "prepared"
"""In the run folder: all that is made of a video, its dataset among it."""


class Source(NamedTuple):
    """A dataset.

    Attributes:
        folder: Where it is, or will be.
        make: Makes it there as far as it is not there yet; None where nothing makes it.
    """

    folder: Path
    make: Callable[[], object] | None = None


def find_source(data: Path | None, begun: Begun | None, *, out: Path) -> Source:
    """The dataset asked for, else the one that the run was begun with, else the built-in subject's.

    A file is a video, of which a dataset is prepared in the run folder. The built-in subject may be kept
    elsewhere by now, or have to be made again.

    Args:
        data: What is asked for.
        begun: The run that goes on, None for a new one.
        out: The run folder.
    """
    if data is not None:
        return _prepared(data, out / PREPARED_FOLDER) if data.is_file() else Source(data)
    recorded = None if begun is None else begun.settings["data"]
    if recorded is not None and recorded.exists():
        return Source(recorded)
    built_in = made_subject()
    folder = built_in.folder()
    if recorded is not None and recorded.name != folder.name:
        return Source(recorded)

    def make() -> None:
        print(f"no --data: the built-in subject, in {folder}", file=sys.stderr)
        built_in.dataset()

    return Source(folder, make)


def _prepared(video: Path, folder: Path) -> Source:
    """The dataset of a video: what of it is made, by an earlier run that was stopped, is not made again."""

    def make() -> None:
        # with decoders of videos: 20 MB that a run on a dataset has no use for
        from samira_warp.prepare.config import PrepareConfig
        from samira_warp.prepare.run import prepare

        try:
            prepare(PrepareConfig(video=video, out=folder))
        except KeyboardInterrupt:
            print("stopped before the first step; the same command goes on", file=sys.stderr)
            raise

    return Source(folder / "dataset", make)
