"""What is wrong with a dataset, where, and what to do about it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Literal

from samira_warp.data.pictures import SUFFIXES
from samira_warp.support.errors import UserError

MOST_ALIKE = 12
"""Findings of one kind in one folder that are told one by one."""

OTHER_FLAME = (
    "give the head model that was tracked with --flame, FLAME's 2020 and 2023 versions are two, "
    "or track again with the one that you have"
)

_SUFFIXES = (".json", ".npz", ".npy", ".frame", ".pkl", ".pickle", ".obj", *SUFFIXES)
_FILE = re.compile(rf"(?P<path>.*?({'|'.join(map(re.escape, _SUFFIXES))}))(:|$)", re.IGNORECASE)
_SIZED_BY_THE_HEAD = re.compile(r": (?:expr|shape|expression|identity|static_offset|dynamic_offset)$")
_ANOTHER_COUNT = re.compile(r"numbers of shape|coefficients, as the head template has")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        severity: With a "fault" there is no training, or none that could succeed; a "warning" is for a person
            to judge.
        subject: The file, key or folder.
        expected: What should be there.
        found: What is there.
        remedy: What to do about it.
    """

    severity: Literal["fault", "warning"]
    subject: str
    expected: str
    found: str
    remedy: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.subject}: expected {self.expected}, found {self.found}; {self.remedy}"

    def as_error(self) -> UserError:
        """The same for a verb that cannot go on."""
        return UserError(self.subject, expected=self.expected, found=f"{self.found}; {self.remedy}")


def finding_of(fault: UserError) -> Finding:
    """A reader's fault with its remedy."""
    return Finding("fault", fault.subject, fault.expected, fault.found, _remedy(fault))


def in_lines(findings: Iterable[Finding]) -> list[str]:
    """A line for each finding.

    Of many that differ in their file alone, the first `MOST_ALIKE` and how many more there are.
    """
    lines = []
    for _, group in groupby(findings, key=_kind):
        alike = list(group)
        lines += [f"{one.severity}: {one}" for one in alike[:MOST_ALIKE]]
        if len(alike) > MOST_ALIKE:
            more = f"{len(alike) - MOST_ALIKE} more like these; --json names them all"
            lines.append(f"{alike[0].severity}: {_folder(alike[0].subject)}: {more}")
    return lines


def _kind(finding: Finding) -> tuple[str, str, str, str]:
    return finding.severity, _folder(finding.subject), finding.found, finding.remedy


def _folder(subject: str) -> str:
    file = _FILE.match(subject)
    return str(Path(file["path"]).parent) if file else subject


def _remedy(fault: UserError) -> str:
    """By the kind of file, and whether it is there."""
    file = _FILE.match(fault.subject)
    path = Path(file["path"] if file else "")
    suffix = path.suffix.lower()
    if "--flame FILE" in fault.expected:
        return "get FLAME from flame.is.tue.mpg.de and name its file with --flame"
    if _SIZED_BY_THE_HEAD.search(fault.subject) and _ANOTHER_COUNT.search(fault.expected):
        return OTHER_FLAME
    if fault.found == "no such file":
        return "put the file there, export the dataset again, or take what names it out of the lists"
    if suffix in SUFFIXES:
        if "pixels as" in fault.expected:
            return "bring it to that size; pictures must not be cropped or scaled after they were tracked"
        return "copy or export the picture again, or take its frame out"
    if suffix in (".npz", ".npy", ".frame") and "template" not in path.name:
        return "track or export this frame again, or take it out of the lists"
    if suffix == ".json":
        return "correct it there, or export the dataset again"
    if suffix:
        return "get or write the file again"
    return "complete the folder, or export the dataset again"
