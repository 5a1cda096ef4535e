"""How good a tracking is, in words: the words, and the reports that they are in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from samira_warp.check.findings import Finding

Word = Literal["good", "fair", "poor"]
"""In words, from best to worst."""


@dataclass(frozen=True)
class Grade:
    """One thing that is measured of a tracking.

    Attributes:
        subject: What it is.
        word: How good it is.
        text: The measurement in words, without the grade.
        overall: Numbers of the sequence, by name.
        frames: One number of each frame that has it, by the frame's name.
    """

    subject: str
    word: Word
    text: str
    overall: dict[str, float]
    frames: dict[str, float]

    def __str__(self) -> str:
        """The grade and its reason."""
        return f"{self.word}: {self.text}"


def overall_grade(grades: Sequence[Grade]) -> Word:
    """The worst of some grades, at least one."""
    words = {grade.word for grade in grades}
    return "poor" if "poor" in words else "fair" if "fair" in words else "good"


def poor_findings(grades: Sequence[Grade], root: Path) -> list[Finding]:
    """A warning for each poor grade that no symptom stands for; mattes have warnings of their own."""
    expected = {
        "landmarks": "the mesh on the landmarks of its pictures",
        "steadiness": "a head that moves smoothly",
    }
    remedy = "look at the contact sheet and, where it shows the same, track again"
    return [
        Finding("warning", str(root), expected[grade.subject], grade.text, remedy)
        for grade in grades
        if grade.word == "poor" and grade.subject in expected
    ]


def word_of(value: float, *, good: float, fair: float) -> Word:
    """By two thresholds, of what is better where it is less."""
    return "good" if value <= good else "fair" if value <= fair else "poor"


def worst_of(frames: dict[str, float]) -> str:
    """The frame with the most pixels."""
    name = max(frames, key=frames.__getitem__)
    return f"worst in {name}: {frames[name]:.1f} pixels"
