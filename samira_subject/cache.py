"""Where the built-in subject is kept, and making it where it is not yet."""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path

from samira_subject.cast import build_cast
from samira_subject.make import make_subject
from samira_subject.plan import VERSION, SubjectPlan
from samira_warp.data.subjects import MadeSubject
from samira_warp.head.template import HeadTemplate
from samira_warp.io.alone import alone
from samira_warp.io.files import cache_folder, read_json
from samira_warp.support.errors import UserError, in_words

_ELSEWHERE = "(SAMIRA_WARP_CACHE names another)"


def subject_folder(seed: int = 0) -> Path:
    """The folder of the dataset of a seed, whether it is there or not.

    Raises:
        UserError: The user has no home folder, and SAMIRA_WARP_CACHE names no other.
    """
    return cache_folder() / "subject" / f"subject-{VERSION}-seed{seed}"


def built_in_subject(seed: int = 0) -> Path:
    """The folder of the built-in subject's dataset, which is made on its first use.

    A line on standard error says that it is being made. A folder that is not whole, or that holds something
    else, is made again.

    Raises:
        UserError: It cannot be written.
    """
    folder = subject_folder(seed)
    try:
        if not _is_whole(folder, seed):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with alone(folder, what="the built-in subject"):
                if not _is_whole(folder, seed):  # another process may have made it
                    _announce(folder)
                    make_subject(folder, SubjectPlan(seed=seed), partial(build_cast, seed))
    except OSError as error:
        expected = f"a folder that can be written {_ELSEWHERE}"
        raise UserError(folder, expected=expected, found=in_words(error)) from error
    return folder


def _head() -> HeadTemplate:
    from samira_subject.head import build_template  # loads what a folder's name does not need

    return build_template()


BUILT_IN = MadeSubject(folder=subject_folder, dataset=built_in_subject, head=_head)
"""What `samira_warp.data.subjects` offers as ``built_in``."""


def _is_whole(folder: Path, seed: int) -> bool:
    """Whether the folder holds what this version makes of a seed.

    Raises:
        UserError: It is no folder: somebody's file is not replaced.
    """
    if not folder.is_dir():
        if os.path.lexists(folder):
            raise UserError(
                folder,
                expected=f"a folder {_ELSEWHERE}",
                found="a broken link" if folder.is_symlink() else "a file",
            )
        return False
    try:
        facts = read_json(folder / "dataset.json")
    except UserError:
        return False
    return (facts.get("version"), facts.get("seed")) == (VERSION, seed)


def _announce(folder: Path) -> None:
    if folder.exists():
        print(f"{folder} is not the whole built-in subject: making it again", file=sys.stderr)
    else:
        print(f"making the built-in subject, once, in {folder}", file=sys.stderr)
