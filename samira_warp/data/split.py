"""Which frames train and which test: one grammar for every verb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from samira_warp.support.errors import UserError

GRAMMAR = (
    "train or test (the dataset's own split), a fraction between 0 and 1 for the first share that trains, "
    "or last:N for N test frames"
)


@dataclass(frozen=True)
class Split:
    """How a sequence is divided, and which part a verb that looks at one part means.

    Attributes:
        text: As the user wrote it.
        kind: "dataset" keeps the dataset's own lists, "fraction" trains on the first share, "last" tests on
            the last timesteps.
        value: The share of timesteps that trains, the number of timesteps that tests, or 0 for the dataset's
            own.
        part: The part that evaluate and render take.
    """

    text: str
    kind: Literal["dataset", "fraction", "last"]
    value: float = 0
    part: Literal["train", "test"] = "test"


def parse_split(text: str) -> Split:
    """Read a SPLIT.

    It is ``dataset``, ``train`` or ``test`` (all three the dataset's own), ``0.7``, or ``last:350``.

    Raises:
        UserError: ``text`` is none of these.
    """
    if text in ("dataset", "test"):
        return Split(text, "dataset")
    if text == "train":
        return Split(text, "dataset", part="train")
    count = text.removeprefix("last:")
    if count != text and count.isdecimal() and int(count) > 0:
        return Split(text, "last", int(count))
    try:
        share = float(text)
    except ValueError:
        share = 0.0
    if not 0.0 < share < 1.0:
        raise UserError("--split", expected=GRAMMAR, found=repr(text))
    return Split(text, "fraction", share)


def divide_timesteps(split: Split, timesteps: Sequence[int]) -> tuple[set[int], set[int]]:
    """Timesteps that train and timesteps that test, for a split that is not the dataset's own.

    Whole timesteps are divided, so that no camera's view of a training moment is tested.

    Raises:
        UserError: One of the two is empty.
    """
    ordered = sorted(set(timesteps))
    first_test = (
        round(split.value * len(ordered)) if split.kind == "fraction" else len(ordered) - int(split.value)
    )
    if not 0 < first_test < len(ordered):
        raise UserError(
            f"--split {split.text}",
            expected="train and test frames",
            found=f"an empty part of {len(ordered)} timesteps",
        )
    return set(ordered[:first_test]), set(ordered[first_test:])
