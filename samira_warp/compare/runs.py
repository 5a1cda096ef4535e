"""What of a finished run is compared, and that runs can be: they are whole, and of the same data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from samira_warp.ablate.table import HEADINGS, Score, scores_in
from samira_warp.avatar import DrivingFrame, read_frames
from samira_warp.avatar.storage.description import read_description
from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.train.begun import AVATAR_FOLDER, CONFIG_FILE, read_begun
from samira_warp.train.metrics import METRICS_FILE, read_metrics
from samira_warp.train.run import RESULTS_FILE

DATA = ("frames_hash", "train_frames", "test_frames", "template_hash")
"""Facts of config.json that are equal where runs saw the same data."""


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A run that has finished.

    Attributes:
        name: What it is called in the report; no two have one name.
        folder: Where it is.
        record: How it was made, as config.json has it.
        settings: Its settings by name; those that were new since then have their defaults.
        results: Its scores, as results.json has them.
        metrics: The lines of metrics.jsonl.
        version: Of its avatar folder's format.
        frames: The test frames as its avatar keeps them.
    """

    name: str
    folder: Path
    record: Mapping[str, Any]
    settings: Mapping[str, Any]
    results: Mapping[str, Any]
    metrics: tuple[dict[str, Any], ...]
    version: int
    frames: tuple[DrivingFrame, ...]

    @property
    def scores(self) -> dict[Score, float]:
        """Of whole frames and of the foreground, those that there are."""
        return scores_in({name: self.results.get(name) for name in HEADINGS})


def read_runs(folders: Sequence[Path]) -> list[TrainedRun]:
    """Read runs that can be compared.

    Args:
        folders: Run folders.

    Raises:
        UserError: A folder is no run, is named twice, has not finished, or cannot be read; its avatar is of a
            format that is not known here; or a run saw other data than the first.
    """
    for number, folder in enumerate(folders):
        if folder.resolve() in [other.resolve() for other in folders[:number]]:
            raise UserError(folder, expected="runs that are not the same", found="it twice")
    names = _names(folders)
    runs = [_read(folder, name) for folder, name in zip(folders, names, strict=True)]
    for run in runs[1:]:
        _check_data(run, runs[0])
    return runs


def _read(folder: Path, name: str) -> TrainedRun:
    if not (folder / CONFIG_FILE).is_file():
        if folder.is_dir():
            found = f"no {CONFIG_FILE} in it"
        else:
            found = "a file" if folder.exists() else "no such folder"
        raise UserError(folder, expected="a run folder", found=found)
    begun, metrics = read_begun(folder, None), read_metrics(folder)
    done, steps = metrics[-1]["step"] if metrics else 0, begun.record["steps"]
    if not metrics and (folder / RESULTS_FILE).is_file():
        raise UserError(folder / METRICS_FILE, expected="what the run has logged", found="nothing")
    finished = (folder / RESULTS_FILE).is_file() and (folder / AVATAR_FOLDER).is_dir()
    if not finished or done < steps:
        found = f"one at step {done} of {steps}" if done < steps else "one that has not been scored"
        raise UserError(folder, expected="a run that has finished", found=found)
    avatar = folder / AVATAR_FOLDER
    version = read_description(avatar).version
    results = _read_results(folder / RESULTS_FILE)
    frames = tuple(frame for frame in read_frames(avatar) if frame.part == "test")
    if {frame.name for frame in frames} != set(results["frames"]):
        raise UserError(folder / RESULTS_FILE, expected="scores of the avatar's test frames", found="others")
    return TrainedRun(name, folder, begun.record, begun.settings, results, metrics, version, frames)


def _read_results(path: Path) -> dict[str, Any]:
    results = read_json(path)
    for part in ("frames", "protocol"):
        if not isinstance(results.get(part), dict):
            raise UserError(f"{path}: {part}", expected="an object", found=type(results.get(part)).__name__)
    for name in HEADINGS:
        value = results.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise UserError(f"{path}: {name}", expected="a score", found=repr(value))
    return results


def _check_data(run: TrainedRun, first: TrainedRun) -> None:
    """Raise UserError, naming what differs, unless a run saw the first one's data."""
    for name in DATA:
        own, wanted = run.record.get(name), first.record.get(name)
        if own != wanted:
            raise UserError(
                f"{run.folder}: {name}",
                expected=f"the data of {first.folder}, {first.record.get('subject')} ({_short(wanted)})",
                found=f"{run.record.get('subject')} ({_short(own)})",
            )


def _short(value: object) -> str:
    """Enough of a hash to tell it from another."""
    return str(value)[:12]


def _names(folders: Sequence[Path]) -> list[str]:
    """The shortest ends of the folders' paths that tell them apart, by number where none does."""
    parts = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    raise AssertionError("folders were told apart before")
