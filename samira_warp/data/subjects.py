"""Subjects that are made rather than filmed: each has a package of its own, loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import NamedTuple

from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError

GROUP = "samira_warp.subjects"
"""The entry points by which a package offers subjects: a name, and where its `MadeSubject` is."""

BUILT_IN = "built_in"
"""The subject of whoever has no data."""

_BUILT_IN = EntryPoint(name=BUILT_IN, value="samira_subject.cache:BUILT_IN", group=GROUP)
"""Not in pyproject.toml: a checkout that is not installed has it, too."""


class MadeSubject(NamedTuple):
    """A subject whose dataset is made when it is first asked for.

    Attributes:
        folder: Says where the dataset is, or will be.
        dataset: Makes it where it is not there yet, and says where; raises UserError where it cannot.
        head: Builds its head model, which other people may be tracked with.
    """

    folder: Callable[[], Path]
    dataset: Callable[[], Path]
    head: Callable[[], HeadTemplate]


def made_subject(name: str = BUILT_IN) -> MadeSubject:
    """The subject of a name; its package is imported.

    Raises:
        UserError: Nobody offers one of that name.
    """
    offers = [_BUILT_IN] if name == BUILT_IN else [*entry_points(group=GROUP, name=name)]
    if not offers:
        names = sorted({BUILT_IN, *entry_points(group=GROUP).names})
        raise UserError("subject", expected=f"one of {', '.join(names)}", found=repr(name))
    subject: MadeSubject = offers[0].load()
    return subject
