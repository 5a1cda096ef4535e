"""What a run folder holds of a run that was begun in it, and whether that run can go on."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.train.checkpoint import checkpoint_step, last_checkpoint
from samira_warp.train.schedule import Earlier, Schedule
from samira_warp.train.settings import settings_of

CONFIG_FILE, AVATAR_FOLDER, CHECKPOINTS_FOLDER = "config.json", "avatar", "checkpoints"
"""Names in a run folder."""

LENGTHS = ("steps", "earlier_lengths")
"""Facts of config.json that say how long a run is to be, and was to be before it was extended."""

RECORDED_ONLY = ("settings", *LENGTHS, "versions", "subject", "torch_threads", "ranks")
"""Facts of config.json that are not compared when a run goes on: settings and lengths are seen to one by one,
the others may differ."""


@dataclass(frozen=True)
class Begun:
    """A run that goes on.

    Attributes:
        record: How it was made, as config.json has it.
        settings: Its settings by name.
        schedule: What was to happen when.
        checkpoint: Its last checkpoint, None before the first.
        step: Steps done by then.
    """

    record: dict[str, Any]
    settings: dict[str, Any]
    schedule: Schedule
    checkpoint: Path | None
    step: int


def find_begun(folder: Path, *, resume: bool) -> Begun | None:
    """The run to go on with, None where a new one begins.

    Raises:
        UserError: A new run would overwrite the one that is there, or there is one that cannot go on.
    """
    checkpoints, finished = folder / CHECKPOINTS_FOLDER, (folder / AVATAR_FOLDER).exists()
    begun = any(checkpoints.glob("step_*"))
    if not resume:
        if begun or finished:
            expected = "a new folder, or --resume to go on with the run there" if begun else "a new folder"
            found = "a run" if begun else "a finished avatar"
            raise UserError(folder, expected=expected, found=found)
        return None
    if finished and not begun:
        raise UserError(
            checkpoints, expected="a checkpoint to go on from, for the avatar stays as it is", found="none"
        )
    if not begun and not (folder / CONFIG_FILE).exists():
        return None
    return read_begun(folder, last_checkpoint(checkpoints) if begun else None)


def check_same(begun: Begun, facts: Mapping[str, Any], *, folder: Path, also: Collection[str] = ()) -> None:
    """Raise UserError unless a run goes on with what it was begun with.

    Args:
        begun: The run.
        facts: What it would be begun with now, as JSON values.
        folder: The run folder, for the message.
        also: Names in RECORDED_ONLY that are compared all the same.
    """
    for name, value in facts.items():
        then = begun.record.get(name)
        if (name not in RECORDED_ONLY or name in also) and then != value:
            raise UserError(f"{folder}: {name}", expected=f"{then} as the run was begun", found=value)


def say_other_bits(begun: Begun, facts: Mapping[str, Any]) -> None:
    """Say on standard error what of the machine is not as it was: then the bits will differ."""
    ranks, now = begun.record.get("ranks", 1), facts["ranks"]
    if ranks != now:
        print(f"begun by {ranks} processes, now by {now}: the bits will differ", file=sys.stderr)
    threads, now = begun.record.get("torch_threads"), facts["torch_threads"]
    if threads != now:
        print(f"begun with {threads} threads, now {now}: the bits will differ", file=sys.stderr)
    device, now = begun.settings["device"], facts["settings"]["device"]
    if device.partition(":")[0] != now.partition(":")[0]:  # the number of a GPU changes nothing
        print(f"begun on {device}, now on {now}: the bits will differ", file=sys.stderr)


def read_begun(folder: Path, checkpoint: Path | None) -> Begun:
    """The run that a folder's config.json tells of, to go on from a checkpoint or, without one, to compare.

    Raises:
        UserError: The file is missing, or does not hold what it should.
    """
    path = folder / CONFIG_FILE
    record = read_json(path)
    for name, kind in (("settings", dict), ("encoder", str), ("steps", int)):
        if not isinstance(record.get(name), kind):
            raise UserError(
                f"{path}: {name}", expected="how the run was begun", found=type(record.get(name)).__name__
            )
    try:
        earlier = tuple(Earlier(int(steps), int(until)) for steps, until in record.get("earlier_lengths", []))
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: earlier_lengths", expected="pairs of steps", found=error) from error
    return Begun(
        record=record,
        settings=settings_of(record["settings"], source=path),
        schedule=Schedule(record["steps"], earlier),
        checkpoint=checkpoint,
        step=0 if checkpoint is None else checkpoint_step(checkpoint),
    )
