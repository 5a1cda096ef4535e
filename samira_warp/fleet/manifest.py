"""What a fleet is to do: a TOML file with its subjects, their options, and what the stages take of a machine.

    [train]                        # options of a verb, for all subjects
    max-steps = 3000

    [resources.train]              # what a stage takes of a machine
    cores = 2
    gpus = 1
    memory-gb = 8

    [[subject]]
    name = "anna"
    video = "films/anna.mp4"       # is prepared first
    train = { seed = 7 }           # her own options

    [[subject]]
    name = "ben"
    data = "datasets/ben"          # a dataset folder

TOML, for an option is a number, a word, a switch or a list of them, which a CSV's cells do not tell apart,
and for people write manifests, with comments, which JSON has none of. Python reads it without another
package. Paths are relative to the manifest's folder.
"""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args, get_type_hints

from samira_warp.evaluate.config import EvaluateConfig
from samira_warp.export.config import ExportConfig
from samira_warp.prepare.config import PrepareConfig
from samira_warp.support.cli import fault, nearest
from samira_warp.support.errors import UserError
from samira_warp.train.config import TrainConfig

VERBS: dict[str, tuple[type, tuple[str, ...], tuple[str, ...]]] = {
    "prepare": (PrepareConfig, ("video", "out"), ("VIDEO", "--out", "OUT")),
    "train": (TrainConfig, ("data", "out", "resume"), ()),
    "evaluate": (EvaluateConfig, ("pred", "data", "truth", "layer"), ("--pred", "PRED", "--data", "DATA")),
    "export": (ExportConfig, ("avatar", "out"), ("--avatar", "RUN", "--out", "FILE")),
}
"""The verb behind each stage, in their order: its options, those that the fleet itself chooses, and words in
the place of those that it has to have."""

_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"


@dataclass(frozen=True)
class Resources:
    """What a stage takes of a machine.

    Attributes:
        cores: CPU cores, and threads of torch and Warp.
        gpus: GPUs, or a share of one that others use as well.
        memory_gb: Memory in 10^9 bytes, by which stages are placed.
    """

    cores: int = 1
    gpus: float = 0.0
    memory_gb: float = 4.0


@dataclass(frozen=True)
class Subject:
    """A row of the manifest.

    Attributes:
        name: What its folder is called.
        source: The film, or the dataset's folder.
        is_video: Whether it is a film, which is prepared first.
        options: The words of its options, by stage.
    """

    name: str
    source: Path
    is_video: bool
    options: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Manifest:
    """What a fleet is to do.

    Attributes:
        subjects: In the order of the file.
        resources: By stage.
    """

    subjects: tuple[Subject, ...]
    resources: Mapping[str, Resources] = field(default_factory=dict)


def read_manifest(path: Path) -> Manifest:
    """Read and check a manifest; films and datasets are looked at when their turn comes.

    Raises:
        UserError: It is no TOML, has keys that mean nothing, or options that a verb does not have.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(path, expected="a manifest in TOML", found=error) from error
    _check_keys(path, table, (*VERBS, "resources", "subject"))
    shared = {stage: _table(f"{path}: {stage}", table.get(stage, {})) for stage in VERBS}
    resources = _table(f"{path}: resources", table.get("resources", {}))
    _check_keys(f"{path}: resources", resources, tuple(VERBS))
    rows = table.get("subject")
    if not isinstance(rows, list) or not rows:
        raise UserError(path, expected="a [[subject]] at least", found="none")
    subjects = tuple(_subject(path, number, row, shared) for number, row in enumerate(rows))
    names = [subject.name for subject in subjects]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{path}: {name}", expected="one subject of this name", found=names.count(name))
    return Manifest(
        subjects,
        {stage: _resources(f"{path}: resources.{stage}", resources.get(stage, {})) for stage in VERBS},
    )


def _subject(path: Path, number: int, row: Any, shared: Mapping[str, Mapping[str, Any]]) -> Subject:
    place = f"{path}: subject {number}"
    row = _table(place, row)
    name = row.get("name")
    if not isinstance(name, str) or not re.fullmatch(_NAME, name):
        raise UserError(f"{place}: name", expected="letters, digits, '_', '-' and '.'", found=repr(name))
    place = f"{path}: {name}"
    _check_keys(place, row, ("name", "video", "data", *VERBS))
    sources = [key for key in ("video", "data") if key in row]
    if len(sources) != 1 or not isinstance(row[sources[0]], str):
        found = (
            " and ".join(sources) if len(sources) > 1 else repr(row.get(sources[0])) if sources else "neither"
        )
        raise UserError(place, expected="the path of a video, or of a dataset as data", found=found)
    options = {
        stage: _words(
            f"{place}: {stage}",
            stage,
            {**shared[stage], **_table(f"{place}: {stage}", row.get(stage, {}))},
            path.parent,
        )
        for stage in VERBS
    }
    return Subject(name, path.parent / row[sources[0]], sources == ["video"], options)


def _resources(place: str, row: Any) -> Resources:
    row = _table(place, row)
    _check_keys(place, row, ("cores", "gpus", "memory-gb"))
    values = {name.replace("-", "_"): value for name, value in row.items()}
    for name, value in row.items():
        kinds: tuple[type, ...] = (int,) if name == "cores" else (int, float)
        is_number = isinstance(value, kinds) and not isinstance(value, bool)
        if not is_number or value < int(name == "cores") or (name == "memory-gb" and value <= 0):
            expected = {"cores": "a whole number from 1 on", "gpus": "0 or more"}.get(name, "more than 0")
            raise UserError(f"{place}: {name}", expected=expected, found=repr(value))
    return Resources(**values)


def _table(place: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise UserError(place, expected="a table", found=repr(value))
    return value


def _check_keys(place: object, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            meant = nearest(key, known)
            found = key if meant is None else f"{key}, did you mean {meant}?"
            raise UserError(place, expected=f"one of {', '.join(known)}", found=found)


def _words(place: str, stage: str, options: Mapping[str, Any], folder: Path) -> tuple[str, ...]:
    """Options as a shell has them: ``seed = 7`` is ``--seed 7``, and ``jitter = false`` is ``--no-jitter``.

    Raises:
        UserError: The verb has no such option, or one that is the fleet's to choose.
    """
    config_type, own, _ = VERBS[stage]
    hints = get_type_hints(config_type)
    words: list[str] = []
    for key, value in options.items():
        name = key.replace("-", "_")
        if name in own:
            raise UserError(place, expected="options that the fleet does not choose itself", found=key)
        values = value if isinstance(value, list) else [value]
        if isinstance(value, bool):
            words.append(f"--{'' if value else 'no-'}{key}")
        elif all(isinstance(each, str | int | float) for each in values):
            is_path = Path in (hints.get(name), *_parts(hints.get(name)))
            words += [f"--{key}", *(str(folder / str(each)) if is_path else str(each) for each in values)]
        else:
            raise UserError(
                f"{place}: {key}", expected="a word, a number, a switch, or a list", found=repr(value)
            )
    wrong = _fault(stage, tuple(words))
    if wrong is not None:
        raise UserError(place, expected=f"options of samira-warp {stage}", found=wrong)
    return tuple(words)


@functools.cache
def _fault(stage: str, words: tuple[str, ...]) -> str | None:
    """What is wrong with the words of a stage's options: once for all subjects that have the same."""
    config_type, _, needed = VERBS[stage]
    return fault(config_type, [*needed, *words])


def _parts(hint: Any) -> list[Any]:
    """What a type is put together from."""
    return [part for inner in get_args(hint) for part in (inner, *_parts(inner))]
