"""The whole check of a dataset: what it holds, what is wrong with it, and a sheet for a person to look at."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from samira_warp.check.drawing import mesh_sheet
from samira_warp.check.facts import head_facts, listing_facts
from samira_warp.check.findings import Finding, in_lines
from samira_warp.check.opening import open_collecting
from samira_warp.check.pictures import undecodable, unlisted
from samira_warp.check.symptoms import symptoms_of
from samira_warp.check.views import sampled_views
from samira_warp.data import recognise


@dataclass(frozen=True)
class Report:
    """What a check found.

    Attributes:
        facts: What the dataset holds, by name.
        notes: What a user should know of how it was read.
        findings: All that is wrong; faults of files first.
        sheet: (rows, columns, 3) float32 display values, the mesh over some frames; None where none could be
            drawn.
    """

    facts: dict[str, str]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    sheet: np.ndarray | None

    @property
    def faults(self) -> int:
        """How many findings stand against training."""
        return sum(finding.severity == "fault" for finding in self.findings)

    def text(self) -> str:
        """One fact or finding a line."""
        named = [*self.facts.items(), *(("note", note) for note in self.notes)]
        return "\n".join([*(f"{name + ':':<15}{value}" for name, value in named), *in_lines(self.findings)])

    def json(self) -> str:
        """The same as a JSON object: facts, notes, findings, and whether training can begin."""
        findings = [asdict(finding) for finding in self.findings]
        return json.dumps(
            {"trainable": not self.faults, "facts": self.facts, "notes": self.notes, "findings": findings},
            indent=1,
        )


def check_dataset(
    root: Path, *, split: str = "dataset", flame: Path | None = None, quick: bool = False
) -> Report:
    """Read a dataset as training would, but to the end.

    Args:
        root: The dataset's folder.
        split: How to divide it, as `open_sequence` takes it.
        flame: FLAME's file or a template, for a dataset without one.
        quick: Decode no pictures but the masks of a dozen frames, and draw nothing.

    Raises:
        UserError: The folder is missing or of no known format, or ``split`` is none.
    """
    opened = open_collecting(root, split=split, flame=flame)
    listing, sequence, findings = opened.listing, opened.sequence, list(opened.faults)
    if listing is None:
        return Report({"folder": str(root), "format": recognise(root).name}, (), tuple(findings), None)
    facts, sheet = listing_facts(listing, divided=opened.divided), None
    views = [] if sequence is None else sampled_views(sequence, opened.sound)
    if not quick:
        findings += undecodable(listing.frames)
    if sequence is not None:
        facts |= head_facts(sequence, views)
        findings += symptoms_of(sequence, views)
        if views and not quick:
            train = set(sequence.train)
            parts = {
                frame.name: "train" if index in train else "test"
                for index, frame in enumerate(sequence.frames)
            }
            sheet = mesh_sheet(views, sequence.template.faces, parts=parts if opened.divided else {})
    findings += unlisted(listing)
    return Report(facts, listing.notes, tuple(findings), sheet)
