"""Opening a dataset to the end, whatever is wrong with its parts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

from samira_warp.check.findings import Finding, finding_of
from samira_warp.check.symptoms import symptoms_of
from samira_warp.check.views import sampled_views
from samira_warp.data import Listing, TrackedSequence, open_listing, open_sequence, recognise
from samira_warp.data.split import parse_split
from samira_warp.support.errors import UserError
from samira_warp.support.faults import collected_faults

_ANY_SPLIT = "0.7"


class Opened(NamedTuple):
    """What could be read.

    Attributes:
        listing: The frames whose files are in order, None where there are none.
        sequence: The same with the head that was tracked, None where it could not be read; frames whose
            parameters are at fault have the neutral ones.
        divided: Whether the frames are divided as was asked for.
        faults: All that is wrong with the files.
    """

    listing: Listing | None
    sequence: TrackedSequence | None
    divided: bool
    faults: tuple[Finding, ...]

    @property
    def sound(self) -> tuple[int, ...]:
        """Indices of the sequence's frames whose parameters are in order."""
        if self.sequence is None:
            return ()
        faulty = {
            part for fault in self.faults for part in (fault.subject, fault.subject.rpartition(": ")[0])
        }
        return tuple(
            index
            for index, frame in enumerate(self.sequence.frames)
            if str(frame.parameters_path) not in faulty
        )


def open_collecting(root: Path, *, split: str, flame: Path | None) -> Opened:
    """Open a dataset and find all that is wrong with its files; no pixels are decoded.

    Args:
        root: The dataset's folder.
        split: As `open_sequence` takes it.
        flame: As `open_sequence` takes it.

    Raises:
        UserError: The folder is missing or of no known format, or ``split`` is none.
    """
    parse_split(split)
    recognise(root)
    sequence: TrackedSequence | None = None
    listing: Listing | None = None
    with collected_faults() as faults:
        sequence = listing = open_sequence(root, split=split, flame=flame)
    if sequence is None:
        with collected_faults():
            listing = open_listing(root, split=split)
    divided = listing is not None
    if not divided:
        # a list of its own may be all that is wrong: divided in another way, the rest can be looked at
        with collected_faults() as more:
            sequence = listing = open_sequence(root, split=_ANY_SPLIT, flame=flame)
        faults += more
    faults += () if listing is None else listing.doubts
    return Opened(listing, sequence, divided, tuple(finding_of(fault) for fault in _telling(root, faults)))


def open_checked(root: Path, *, split: str = "dataset", flame: Path | None = None) -> TrackedSequence:
    """Open a dataset to train on it: `open_sequence` with the quick part of the check.

    Warnings are printed on standard error, a line each.

    Raises:
        UserError: As in open_sequence, with how many faults there are; or the head cannot be where the
            pictures show it.
    """
    recognise(root)  # what is no dataset needs no head model either
    sequence: TrackedSequence | None = None
    with collected_faults() as faults:
        sequence = open_sequence(root, split=split, flame=flame)
    faults += () if sequence is None else sequence.doubts
    telling = _telling(root, faults)
    if sequence is None or telling:
        first = telling[0]
        more = (
            f" (and {len(telling) - 1} more faults: python -m samira_warp.check --data {root})"
            if len(telling) > 1
            else ""
        )
        raise UserError(first.subject, expected=first.expected, found=f"{first.found}{more}") from first
    for finding in symptoms_of(sequence, sampled_views(sequence, range(len(sequence.frames)))):
        if finding.severity == "fault":
            raise finding.as_error()
        print(f"{finding.severity}: {finding}", file=sys.stderr)
    return sequence


def _telling(root: Path, faults: list[UserError]) -> list[UserError]:
    """Each fault once.

    Complaints about the folder as a whole are told only where they do not follow from faults of its parts.
    """
    once = list({(fault.subject, fault.found): fault for fault in reversed(faults)}.values())[::-1]
    parts = [
        fault for fault in once if fault.subject != str(root) and not fault.subject.startswith("--split")
    ]
    return parts or once
