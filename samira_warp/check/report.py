"""The whole check of a dataset: what it holds, what is wrong with it, and a sheet for a person to look at."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from samira_warp.check.closeness import grade_landmarks, grade_overlap
from samira_warp.check.drawing import marks_of, mesh_sheet
from samira_warp.check.facts import head_facts, listing_facts, size_notes
from samira_warp.check.findings import Finding, in_lines
from samira_warp.check.grades import Grade, overall_grade, poor_findings
from samira_warp.check.motion import head_motion
from samira_warp.check.opening import open_collecting
from samira_warp.check.pictures import undecodable, unlisted, unused_albedos
from samira_warp.check.steadiness import grade_steadiness
from samira_warp.check.symptoms import symptoms_of
from samira_warp.check.views import View, sampled_views, views_of
from samira_warp.data import TrackedSequence, recognise
from samira_warp.data.landmarks import DetectedLandmarks, read_landmarks
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class Report:
    """What a check found.

    Attributes:
        facts: What the dataset holds, by name.
        notes: What a user should know of how it was read.
        findings: All that is wrong; faults of files first.
        grades: How good the tracking is, where that can be told.
        sheet: (rows, columns, 3) float32 display values, the mesh over some frames; None where none could be
            drawn.
        next_command: The command that trains on it.
    """

    facts: dict[str, str]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    grades: tuple[Grade, ...]
    sheet: np.ndarray | None
    next_command: str

    @property
    def faults(self) -> int:
        """How many findings stand against training."""
        return sum(finding.severity == "fault" for finding in self.findings)

    @property
    def verdict(self) -> str:
        """Whether it can be trained on, and what to do next."""
        if self.faults:
            stand = "1 fault stands" if self.faults == 1 else f"{self.faults} faults stand"
            return f"it cannot be trained on: {stand} against it; mend what is said above, and check again"
        warnings = len(self.findings)
        judged = (
            f", once you have judged the {warnings} warning{'s' * (warnings > 1)} above" if warnings else ""
        )
        return f"it can be trained on{judged}: {self.next_command}"

    def text(self) -> str:
        """One fact or finding a line, and the verdict at the end."""
        graded = [(grade.subject, str(grade)) for grade in self.grades]
        if graded:
            subjects = ", ".join(grade.subject for grade in self.grades)
            graded.insert(0, ("tracking", f"{overall_grade(self.grades)}, the worst of {subjects}"))
        named = [*self.facts.items(), *graded, *(("note", note) for note in self.notes)]
        lines = [f"{name + ':':<15}{value}" for name, value in named]
        return "\n".join([*lines, *in_lines(self.findings), f"{'verdict:':<15}{self.verdict}"])

    def json(self) -> str:
        """The same as a JSON object: whether training can begin, the verdict, facts, notes, findings, grades.

        Grades have their numbers for every frame.
        """
        findings = [asdict(finding) for finding in self.findings]
        report = {"trainable": not self.faults, "verdict": self.verdict, "facts": self.facts}
        grades = {grade.subject: asdict(grade) for grade in self.grades}
        return json.dumps(report | {"notes": self.notes, "findings": findings, "tracking": grades}, indent=1)


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
    command = _train_command(root, split=split, flame=flame)
    if listing is None:
        facts = {"folder": str(root), "format": recognise(root).name}
        return Report(facts, (), tuple(findings), (), None, command)
    facts, sheet = listing_facts(listing, divided=opened.divided), None
    grades: tuple[Grade, ...] = ()
    views = [] if sequence is None else sampled_views(sequence, opened.sound)
    if not quick:
        findings += undecodable(listing.frames)
    if sequence is not None:
        facts |= head_facts(sequence, views)
        symptoms = symptoms_of(sequence, views)
        detected, broken = _landmarks(root)
        findings += [*symptoms, *broken]
        if views and not symptoms:
            # of a head that is elsewhere there is nothing to grade
            grades = _grades(sequence, opened.sound, detected, views if quick else None)
            findings += poor_findings(grades, root)
        if views and not quick:
            train = set(sequence.train)
            parts = {
                frame.name: "train" if index in train else "test"
                for index, frame in enumerate(sequence.frames)
            }
            marks = {} if detected is None else marks_of(sequence, views, detected)
            shown = parts if opened.divided else {}
            sheet = mesh_sheet(views, sequence.template.faces, parts=shown, marks=marks)
    findings += unlisted(listing)
    findings += unused_albedos(listing)
    notes = (*listing.notes, *size_notes(listing))
    return Report(facts, notes, tuple(findings), grades, sheet, command)


def _landmarks(root: Path) -> tuple[DetectedLandmarks | None, list[Finding]]:
    """What a detector found in the pictures, and what is wrong with its file."""
    try:
        return read_landmarks(root), []
    except UserError as fault:
        remedy = "prepare the film again, or delete the file: nothing but this check reads it"
        return None, [Finding("warning", fault.subject, fault.expected, fault.found, remedy)]


def _grades(
    sequence: TrackedSequence,
    indices: Sequence[int],
    detected: DetectedLandmarks | None,
    views: list[View] | None,
) -> tuple[Grade, ...]:
    """Grades of the frames with ``indices``; of mattes, of some ``views``, or of all."""
    template, motion = sequence.template, head_motion(sequence, indices)
    ids = None if template.landmarks is None else template.landmarks.ids
    grades = (
        grade_landmarks(motion, detected, ids),
        grade_overlap(views or views_of(sequence, indices), template.faces, template.v_template),
        grade_steadiness(motion),
    )
    return tuple(grade for grade in grades if grade is not None)


def _train_command(root: Path, *, split: str, flame: Path | None) -> str:
    """The command that trains on what was checked, as a shell takes it."""
    words = ["python", "-m", "samira_warp.train", "--data", str(root)]
    if flame is not None:
        words += ["--flame", str(flame)]
    if split != "dataset":
        words += ["--split", split]
    return shlex.join(words)
