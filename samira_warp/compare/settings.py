"""Which settings of runs differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from samira_warp.compare.runs import TrainedRun

PLACES = ("out", "data", "max_steps", "epochs")
"""Settings that say where a run is, that it saw the same data is known by now, or how long it is, which
``steps`` says."""

FACTS = ("steps", "earlier_lengths", "perceptual", "encoder", "reference_frame", "torch_threads")
"""What config.json says of a run beside its settings and versions."""


def differing_settings(runs: Sequence[TrainedRun]) -> dict[str, list[str]]:
    """What differs between runs in how they were made, in words, one for each run, by its name.

    Settings come first, then the facts of config.json, the versions of packages, and how scores were made.
    """
    facts = [dict(_facts(run)) for run in runs]
    names = dict.fromkeys(name for own in facts for name in own)
    rows = {name: [own.get(name) for own in facts] for name in names}
    return {
        name: [_words(value) for value in values]
        for name, values in rows.items()
        if any(value != values[0] for value in values)
    }


def _facts(run: TrainedRun) -> Iterator[tuple[str, Any]]:
    for name, value in run.settings.items():
        if name not in PLACES:
            yield f"--{name.replace('_', '-')}", value
    for name in FACTS:
        # a run that was begun before lengths were recorded has had but one
        yield name.replace("_", " "), run.record.get(name) or None
    versions = run.record.get("versions")
    for name, value in versions.items() if isinstance(versions, dict) else ():
        yield f"version of {name}", value
    yield "format of the avatar", run.version
    for name, value in run.results["protocol"].items():
        yield f"scores: {name.replace('_', ' ')}", value


def _words(value: Any) -> str:
    if value is None or value in ((), []):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(_words(each) for each in value)
    return str(value)
