"""A subject's way from its film to its scores: the verbs, one after the other, each done once.

    OUT/NAME/prepared     the dataset of a film
    OUT/NAME/run          the training's folder, with the avatar
    OUT/NAME/test         the test frames as the avatar renders them
    OUT/NAME/scores.json  what `evaluate` says of them
    OUT/NAME/avatar.ply   what `export` writes
    OUT/NAME/stages       what is done of what, and what was said

A stage is a process of its own, so that a verb has the threads that the stage was given, takes nobody with it
when it crashes, and gives back all its memory.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TextIO

from samira_warp.fleet.manifest import Manifest, Resources, Subject
from samira_warp.io.files import read_json, replace_file
from samira_warp.support.cli import STATUS_MISTAKE
from samira_warp.support.errors import UserError

PYTHON = (sys.executable,)
"""What runs a verb."""

COMPUTING = ("prepare", "train", "render")
"""Verbs that choose a device."""

RUN, TEST, SCORES, DATASET = "run", "test", "scores.json", "prepared/dataset"
"""Names in a subject's folder."""

State = Literal["waiting", "running", "done", "failed"]


class StageCrashError(Exception):
    """A stage's process ended as no verb does that has said what is wrong: it may be tried again."""


@dataclass(frozen=True)
class Stage:
    """A stage of one subject, as a worker does it.

    Attributes:
        subject: Whose.
        name: One of `manifest.VERBS`.
        folder: The subject's.
        commands: The verbs' words, with Python's before them.
        output: A file for the last command's standard output, None where that belongs to what was said.
        makes: What is there when the stage is done.
        key: Digest of this stage's and all earlier stages' words: another key is another stage.
        resources: What it takes.
    """

    subject: str
    name: str
    folder: Path
    commands: tuple[tuple[str, ...], ...]
    output: Path | None
    makes: tuple[Path, ...]
    key: str
    resources: Resources

    @property
    def mark(self) -> Path:
        """The file that says how far the stage is."""
        return self.folder / "stages" / f"{self.name}.json"

    @property
    def log(self) -> Path:
        """The file of what was said."""
        return self.folder / "stages" / f"{self.name}.log"

    def record(self) -> dict[str, Any]:
        """What the mark says of this stage; empty where it is another's, or there is none."""
        try:
            record = read_json(self.mark)
        except UserError:
            return {}
        return record if record.get("key") == self.key else {}

    @property
    def done(self) -> bool:
        """Whether the stage has finished, and what it made is still there."""
        return self.record().get("state") == "done" and all(path.exists() for path in self.makes)


@dataclass(frozen=True)
class Outcome:
    """How a stage ended.

    Attributes:
        done: Whether what it makes is there.
        why: What went wrong, in a line; empty where nothing did.
    """

    done: bool
    why: str = ""


def stages_of(subject: Subject, manifest: Manifest, out: Path) -> list[Stage]:
    """A subject's stages in their order; a dataset needs no preparation."""
    folder = out / subject.name
    run, pictures, data = folder / RUN, folder / TEST, str(subject.source)
    stages: list[Stage] = []

    def add(name: str, *commands: tuple[object, ...], output: Path | None = None, makes: Path) -> None:
        calls = tuple(("-m", f"samira_warp.{verb}", *map(str, words)) for verb, *words in commands)
        before = stages[-1].key if stages else ""
        key = hashlib.sha256(json.dumps([before, calls]).encode()).hexdigest()[:16]
        resources = manifest.resources[name]
        whole = tuple((*PYTHON, *call, *_device(call, resources)) for call in calls)
        stages.append(Stage(subject.name, name, folder, whole, output, (makes,), key, resources))

    options = subject.options
    if subject.is_video:
        prepared = folder / DATASET
        call = ("prepare", data, "--out", prepared.parent, *options["prepare"])
        add("prepare", call, makes=prepared)
        data = str(prepared)
    add(
        "train",
        ("train", "--data", data, "--out", run, "--resume", *options["train"]),
        makes=run / "results.json",
    )
    add(
        "evaluate",
        ("render", "--avatar", run, "--out", pictures, *_shared(options["train"], "--device")),
        (
            *("evaluate", "--pred", pictures / "image", "--data", data),
            *(() if "--split" in options["evaluate"] else _shared(options["train"], "--split")),
            *options["evaluate"],
        ),
        output=folder / SCORES,
        makes=folder / SCORES,
    )
    exported = folder / f"avatar.{_value(options['export'], '--format') or 'ply'}"
    add("export", ("export", "--avatar", run, "--out", exported, *options["export"]), makes=exported)
    return stages


def _device(call: tuple[str, ...], resources: Resources) -> tuple[str, ...]:
    """Words that keep a verb off GPUs that its stage was not given."""
    computes = call[1].rpartition(".")[2] in COMPUTING
    return ("--device", "cpu") if computes and not resources.gpus and "--device" not in call else ()


def mark_lost(stage: Stage, why: str) -> None:
    """Say in the mark of a stage that it failed, where its own worker could not."""
    record = stage.record()
    if record.get("state") == "running":
        replace_file(stage.mark, json.dumps(record | {"state": "failed", "why": why}, indent=1))


def run_stage(stage: Stage) -> Outcome:
    """Do a stage that is not done yet, on this machine.

    Returns:
        How it ended; a mistake that its verb told of is final.

    Raises:
        StageCrashError: Its process died, or failed without saying why.
    """
    if stage.done:
        return Outcome(True)
    stage.mark.parent.mkdir(parents=True, exist_ok=True)
    tries = int(stage.record().get("tries", 0)) + 1
    began = time.time()
    about = {"key": stage.key, "host": socket.gethostname(), "worker": os.getpid(), "tries": tries}
    about |= {"began": began, "commands": stage.commands}

    def note(state: State, why: str = "") -> None:
        record = {"state": state, **about, "seconds": round(time.time() - began, 3), "why": why}
        replace_file(stage.mark, json.dumps(record, indent=1))

    note("running")
    try:
        with stage.log.open("a", encoding="utf-8") as log:
            outcome = _run_commands(stage, log)
    except StageCrashError as crash:
        note("failed", str(crash))
        raise
    note("done" if outcome.done else "failed", outcome.why)
    return outcome


def _run_commands(stage: Stage, log: TextIO) -> Outcome:
    """The verbs, one after the other, until one fails.

    Raises:
        StageCrashError: One died, or failed without saying why.
    """
    for command in stage.commands:
        before = log.tell()
        kept = stage.output if command == stage.commands[-1] else None
        with _output(kept, log) as output:
            status = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=log,
                env=os.environ | {"OMP_NUM_THREADS": str(stage.resources.cores)},
                preexec_fn=_end_with(os.getpid()),
                check=False,
            ).returncode
        if status != 0:
            said = _last_line(stage.log, before)
            if status == STATUS_MISTAKE and said.startswith("error: "):
                return Outcome(False, said.removeprefix("error: "))
            raise StageCrashError(f"{_ended(status)}; its last words: {said or 'none'}")
        if kept is not None:
            _half(kept).replace(kept)
    return Outcome(True)


def _output(kept: Path | None, log: TextIO) -> TextIO:
    """Where a command's standard output goes."""
    return (
        open(os.dup(log.fileno()), "a", encoding="utf-8")
        if kept is None
        else _half(kept).open("w", encoding="utf-8")
    )


def _half(path: Path) -> Path:
    """The name of a file that is not whole yet."""
    return path.with_name(f".{path.name}.new")


def _end_with(parent: int) -> Callable[[], None] | None:
    """What a new process does to be killed with the one that started it, where the system knows how.

    A worker that is killed is replaced, and its stage begun again: beside what it had started, two trainings
    would be at work in one folder. Ray's own clean-up is a setting of each cluster, and `--row` has none.
    """
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)

    def end() -> None:
        libc.prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it was killed before this
            os._exit(1)

    return end


_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG, of Linux's prctl."""


def _ended(status: int) -> str:
    if status >= 0:
        return f"its process ended with status {status}"
    name = signal.Signals(-status).name
    memory = ", as the system does where memory is short" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{memory}"


def _last_line(path: Path, begin: int) -> str:
    """The last line of a log that has something in it, after so many bytes."""
    with path.open("rb") as file:
        file.seek(begin)
        lines = file.read().decode("utf-8", errors="replace").replace("\r", "\n").splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _value(words: tuple[str, ...], option: str) -> str | None:
    """The word after an option, None where it is not among the words."""
    return words[words.index(option) + 1] if option in words else None


def _shared(words: tuple[str, ...], option: str) -> Iterator[str]:
    """An option with its word, where it is among the words."""
    value = _value(words, option)
    return iter(()) if value is None else iter((option, value))
