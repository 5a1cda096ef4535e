"""How far every subject is, and how it scores: read from what its stages left on the disk."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from samira_warp.fleet.stages import RUN, SCORES, TEST, Stage, State
from samira_warp.io.alone import alone
from samira_warp.io.files import read_json, replace_file
from samira_warp.support.errors import UserError

TABLE_FILE, JSON_FILE = "fleet.md", "fleet.json"
"""Names in the fleet's folder."""

SCORED = {"psnr": "{:.2f}", "ssim": "{:.4f}", "lpips": "{:.4f}"}
"""What `evaluate` gives and the table has, with its format."""

_TAIL = 4096
"""Bytes at the end of metrics.jsonl, in which its last line lies."""


@dataclass(frozen=True)
class Result:
    """A subject's row of the table.

    Attributes:
        subject: Its name.
        state: How far it is.
        stage: The stage that failed, runs or comes next; empty where all are done.
        why: What went wrong; empty where nothing did.
        seconds: What its stages took, those that are kept from earlier.
        scores: Means over the test frames: psnr in dB, ssim, lpips or None; empty before they are known.
        test_frames: How many those are; None before.
        gaussians: N at the last step that was logged; None before.
        files: What is there, by name: paths from the fleet's folder.
    """

    subject: str
    state: State
    stage: str
    why: str
    seconds: float
    scores: dict[str, float | None]
    test_frames: int | None
    gaussians: int | None
    files: dict[str, str]


def result_of(stages: Sequence[Stage], out: Path) -> Result:
    """What the disk says of a subject, by its stages."""
    last = next((stage for stage in stages if not stage.done), None)
    record = {} if last is None else last.record()
    folder = stages[0].folder
    seconds = sum(float(stage.record().get("seconds", 0.0)) for stage in stages)
    scores = _read(folder / SCORES)
    files = {"avatar": folder / RUN / "avatar", "pictures": folder / TEST / "image"}
    files |= {stage.name: path for stage in stages if stage.name == "export" for path in stage.makes}
    if last is not None:
        files["log"] = last.log
    there = {name: path.relative_to(out).as_posix() for name, path in files.items() if path.exists()}
    return Result(
        subject=stages[0].subject,
        state="done" if last is None else _state(record),
        stage="" if last is None else last.name,
        why=str(record.get("why", "")),
        seconds=round(seconds, 3),
        scores={name: scores[name] for name in SCORED if name in scores},
        test_frames=len(scores["frames"]) if "frames" in scores else None,
        gaussians=last_metrics(folder).get("gaussians"),
        files=there,
    )


def _state(record: dict[str, Any]) -> State:
    """The state that a mark tells of; what it made is not there any more where it is done."""
    state: State = record.get("state", "waiting")
    return "waiting" if state == "done" else state


def last_metrics(folder: Path) -> dict[str, Any]:
    """The last line that a subject's training has logged; empty before the first."""
    path = folder / RUN / "metrics.jsonl"
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - _TAIL, 0))
            lines = file.read().splitlines()
        return json.loads(lines[-1]) if lines else {}
    except (OSError, ValueError):
        return {}


def write_results(rows: Sequence[Sequence[Stage]], out: Path) -> list[Result]:
    """Write the table of all subjects, in Markdown and for programs; what it says.

    Args:
        rows: The stages of every subject.
        out: The fleet's folder.
    """
    with alone(out / TABLE_FILE, what="the table"):  # of several tasks, the last one has seen all marks
        results = [result_of(stages, out) for stages in rows]
        replace_file(out / JSON_FILE, json.dumps([asdict(result) for result in results], indent=1))
        replace_file(out / TABLE_FILE, markdown(results))
    return results


def markdown(results: Sequence[Result]) -> str:
    """The table, and below it what went wrong."""
    counts = {state: sum(result.state == state for result in results) for state in ("done", "failed")}
    heads = ("subject", "state", "PSNR, dB", "SSIM", "LPIPS", "test frames", "Gaussians", "time", "files")
    lines = [
        f"# {len(results)} subjects: {counts['done']} done, {counts['failed']} failed",
        "",
        f"| {' | '.join(heads)} |",
        "|---|---|---|---|---|---|---|---|---|",
        *(f"| {' | '.join(_cells(result))} |" for result in results),
    ]
    wrong = [result for result in results if result.state == "failed"]
    if wrong:
        lines += ["", "## What went wrong", ""]
        lines += [f"- **{result.subject}**, {result.stage}: {_escaped(result.why)}" for result in wrong]
    return "\n".join([*lines, ""])


def _cells(result: Result) -> list[str]:
    scores = (
        "" if result.scores.get(name) is None else format.format(result.scores[name])
        for name, format in SCORED.items()
    )
    numbers = ("" if value is None else f"{value:,}" for value in (result.test_frames, result.gaussians))
    links = ", ".join(f"[{name}]({path})" for name, path in result.files.items())
    state = result.state if result.state == "done" else f"{result.state}: {result.stage}"
    return [result.subject, state, *scores, *numbers, in_words(result.seconds), links]


def in_words(seconds: float) -> str:
    """A duration for people."""
    minutes, rest = divmod(round(seconds), 60)
    return (
        f"{minutes // 60} h {minutes % 60} min"
        if minutes >= 60
        else f"{minutes} min {rest} s"
        if minutes
        else f"{rest} s"
    )


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except UserError:
        return {}
