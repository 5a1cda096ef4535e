"""Compare two revisions of this repository: the same command by both, in turns, on this machine, in one run.

usage: python tools/compare_builds.py REVISION [--new REVISION] [--rounds N] [--reuse-environment]
                                      [--command "python -m ..."] [--steps N [--data DIR]] [--json]

Each revision is checked out in a worktree of its own, in a temporary folder, and installed in an environment
of its own with the pins of its constraints.txt; with --reuse-environment this Python runs both, each by
PYTHONPATH. What is not committed is not compared. A machine that others use is slow at one time and quick at
another: therefore each round runs both, one straight after the other, the one that was last first in the next
round (A B, B A, A B, ...), and what is told is the median of the rounds' ratios, with the least and the
greatest.

The command is `python -m samira_warp.bench train --json` unless another is named. Its wall-clock and
processor time are compared, and where it prints JSON the numbers of that, whole numbers where they differ.
--steps trains so many steps as well (instead, where no command is named), and compares time, scores and the
avatar's bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import shlex
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from tyro.conf import Positional

from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

COMMAND = "python -m samira_warp.bench train --json"
"""What is run where nothing else is asked for."""

WARM_UP_STEPS = 2
"""Of the training before the rounds, in which kernels are compiled."""

AVATAR = Path("avatar", "avatar.safetensors")
"""What a training learns, in its run folder."""

LIBRARIES = ("torch", "warp-lang")
"""What decides the speed besides the package: versions are told."""

VERSIONS = f"""
from importlib.metadata import distributions
there = {{d.name: d.version for d in distributions() if d.name in {LIBRARIES}}}
print(", ".join(f"{{name}} {{there.get(name, 'none')}}" for name in {LIBRARIES}))
"""
"""A program that says which of them an environment has."""

SOURCE = "import samira_warp; print(samira_warp.__file__)"
"""A program that says where an environment has the package from."""


@dataclass(frozen=True)
class BuildsConfig:
    """Compare two revisions by the same command, in turns, in one run."""

    old: Positional[str]
    """The revision to compare with, as git names it."""
    new: str = "HEAD"
    """The revision that is compared."""
    rounds: int = 4
    """How often both are run; two and more say how far single rounds differ."""
    command: str | None = None
    """What to run, as a shell has it: `python` is each build's own; default bench train, or nothing beside
    --steps."""
    steps: int | None = None
    """Train so many steps as well, and compare their time, the scores and the bits of the avatar."""
    data: Path | None = None
    """What to train on, a dataset; default the built-in subject."""
    reuse_environment: bool = False
    """Run both by this Python and its libraries, instead of installing each: seconds instead of minutes."""
    repository: Path = Path(__file__).resolve().parents[1]
    """The repository of both; default the one that this program is in."""
    json: bool = False
    """Print a JSON object instead of tables."""


class Build(NamedTuple):
    """A revision that can be run.

    Attributes:
        revision: As it was asked for.
        commit: Its short name and subject.
        folder: Its worktree.
        python: The Python that runs it.
        environment: Variables that it is run with.
        libraries: Which libraries it has.
    """

    revision: str
    commit: str
    folder: Path
    python: str
    environment: Mapping[str, str]
    libraries: str


Numbers = dict[str, float]
"""What one run told, by what it is."""

Job = Callable[[Build, Path], Numbers]
"""Runs something in a build, with an empty folder to write to."""


class Line(NamedTuple):
    """One number of both builds.

    Attributes:
        what: Which.
        old: Median over the rounds.
        new: Likewise.
        ratio: Median of new over old, round by round.
        least: Of those ratios.
        greatest: Likewise.
        difference: Median of new less old, round by round.
    """

    what: str
    old: float
    new: float
    ratio: float
    least: float
    greatest: float
    difference: float


def main(config: BuildsConfig) -> None:
    """Build both, run them in turns, and print what came of it."""
    if config.rounds < 1:
        raise UserError("--rounds", expected="at least 1", found=config.rounds)
    if config.steps is not None and config.steps < 1:
        raise UserError("--steps", expected="at least 1", found=config.steps)
    if config.data is not None and config.steps is None:
        raise UserError("--data", expected="--steps beside it", found="none")
    with tempfile.TemporaryDirectory(prefix="builds-") as name:
        folder = Path(name)
        revisions = {"old": config.old, "new": config.new}
        with worktrees(config.repository, revisions, folder) as trees:
            own = None if config.reuse_environment else folder
            builds = [make_build(name, trees[side], own) for side, name in revisions.items()]
            found = {}
            for says, warm_up, job in jobs(config):
                found[says] = in_turns(builds, warm_up, job, rounds=config.rounds, scratch=folder, says=says)
    lines = {says: compared(rounds) for says, rounds in found.items()}
    if config.json:
        print(json.dumps(as_object(config, builds, found, lines)))
        return
    print_tables(config, builds, found, lines)


@contextlib.contextmanager
def worktrees(repository: Path, revisions: Mapping[str, str], folder: Path) -> Iterator[dict[str, Path]]:
    """Check revisions out, each in a worktree of its own, which is gone afterwards, whatever happens.

    Args:
        repository: Whose.
        revisions: By the name of their worktree in ``folder``.
        folder: Where.

    Raises:
        UserError: There is no such repository or revision.
    """
    for name, revision in revisions.items():
        if not _git(repository, "rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}", check=False):
            raise UserError(name, expected=f"a revision of {repository}", found=revision)
    trees = {name: folder / name for name in revisions}
    try:
        for name, tree in trees.items():
            _git(repository, "worktree", "add", "--detach", "--quiet", str(tree), revisions[name])
        yield trees
    finally:
        with _no_interrupt():
            for tree in trees.values():
                _git(repository, "worktree", "remove", "--force", str(tree), check=False)
            _git(repository, "worktree", "prune", check=False)


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Put off Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _git(repository: Path, *words: str, check: bool = True) -> str:
    """What git says, without the newline; nothing where it fails and need not succeed."""
    done = subprocess.run(
        ["git", "-C", str(repository), *words], capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode != 0 and check:
        raise UserError(f"git {words[0]}", expected="to end well", found=_last_line(done.stderr))
    return done.stdout.strip() if done.returncode == 0 else ""


def make_build(revision: str, tree: Path, folder: Path | None) -> Build:
    """Make a worktree one that can be run.

    Args:
        revision: What it is of.
        tree: The worktree.
        folder: Where to make an environment of its own; None for this Python and its libraries.

    Raises:
        UserError: It cannot be installed, or its Python has the package from elsewhere.
    """
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # sets and dictionaries of sets in one order, so that equal code has equal bits
    variables.setdefault("PYTHONHASHSEED", "0")
    if folder is None:
        python = sys.executable
        paths = [str(tree), *filter(None, [os.environ.get("PYTHONPATH")])]
        variables["PYTHONPATH"] = os.pathsep.join(paths)
    else:
        environment = folder / f"{tree.name}_environment"
        print(f"installing {revision} in an environment of its own", file=sys.stderr)
        _checked([sys.executable, "-m", "venv", str(environment)], tree, variables)
        python = str(environment / "bin" / "python")
        pins = ["-c", "constraints.txt"] if (tree / "constraints.txt").is_file() else []
        _checked([python, "-m", "pip", "install", "--quiet", *pins, "-e", "."], tree, variables)
    source = Path(_checked([python, "-c", SOURCE], tree, variables).strip())
    if not source.resolve().is_relative_to(tree.resolve()):
        raise UserError(revision, expected=f"samira_warp of {tree}", found=source)
    return Build(
        revision,
        _git(tree, "log", "-1", "--format=%h %s"),
        tree,
        python,
        variables,
        _checked([python, "-c", VERSIONS], tree, variables).strip(),
    )


def _checked(words: list[str], folder: Path, variables: Mapping[str, str]) -> str:
    """The standard output of a command that has to end well.

    Raises:
        UserError: It does not.
    """
    done = subprocess.run(
        words, cwd=folder, env=variables, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode != 0:
        found = f"status {done.returncode}: {_last_line(done.stderr) or 'nothing was said'}"
        raise UserError(shlex.join(words), expected="to end well", found=found)
    return done.stdout


def _last_line(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")


def jobs(config: BuildsConfig) -> Iterator[tuple[str, Job, Job]]:
    """What is to be run: its name, what goes before the rounds, and what is run in each."""
    if config.command is not None or config.steps is None:
        words = shlex.split(COMMAND if config.command is None else config.command)
        if not words:
            raise UserError("--command", expected="a command", found="no words")
        yield shlex.join(words), _command(words), _command(words)
    if config.steps is not None:
        yield (
            f"{config.steps} steps of training",
            _training(config.data, WARM_UP_STEPS),
            _training(config.data, config.steps),
        )


def _command(words: Sequence[str]) -> Job:
    def job(build: Build, scratch: Path) -> Numbers:
        del scratch
        printed, numbers = timed(build, words)
        return numbers | numbers_in(printed)

    return job


def _training(data: Path | None, steps: int) -> Job:
    options = [] if data is None else ["--data", str(data.resolve())]

    def job(build: Build, scratch: Path) -> Numbers:
        out = scratch / "run"
        words = ["python", "-m", "samira_warp.train", *options, "--out", str(out), "--max-steps", str(steps)]
        _, numbers = timed(build, words)
        return numbers | scores(out)

    return job


def timed(build: Build, words: Sequence[str]) -> tuple[str, Numbers]:
    """Run a command in a build: what it printed, and its seconds.

    Raises:
        UserError: It failed.
    """
    words = [build.python if word == "python" else word for word in words]
    before, begin = _processor_seconds(), time.perf_counter()
    printed = _checked(words, build.folder, build.environment)
    seconds = time.perf_counter() - begin
    return printed, {"seconds": seconds, "processor seconds": _processor_seconds() - before}


def _processor_seconds() -> float:
    """Of all processes that this one has waited for, and theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def numbers_in(printed: str) -> Numbers:
    """The numbers of the JSON that was printed, alone or on the last line; none of other text."""
    for text in (printed, _last_line(printed)):
        with contextlib.suppress(ValueError):
            return dict(_leaves(json.loads(text), ""))
    return {}


def _leaves(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield name or "value", float(value)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name} {key}".strip())
    elif isinstance(value, list):
        for label, inner in zip(_labels(value), value, strict=True):
            yield from _leaves(inner, f"{name} {label}".strip())


def _labels(rows: list[Any]) -> list[str]:
    """What tells rows apart: fields that are no numbers and not the same in all, or their places."""
    if all(isinstance(row, dict) for row in rows):
        told = [{key: each for key, each in row.items() if isinstance(each, (str, bool))} for row in rows]
        names = [key for key in told[0] if len({row.get(key) for row in told}) > 1] if told else []
        labels = [", ".join(f"{name}={row.get(name)}" for name in names) for row in told]
        if len(set(labels)) == len(rows):
            return labels
    return [str(number) for number in range(len(rows))]


def scores(out: Path) -> Numbers:
    """What a training left in its run folder: its own seconds, scores, and the avatar's hash as a number."""
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    numbers = {name: value for name, value in results.items() if isinstance(value, float)}
    lines = (out / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    last = json.loads(lines[-1])
    steps = {"seconds of the steps": float(last["seconds"])} if "seconds" in last else {}
    # 48 bits are a whole number that a float holds
    digest = hashlib.sha256((out / AVATAR).read_bytes()).hexdigest()[:12]
    return {**steps, **numbers, DIGEST: float(int(digest, 16))}


DIGEST = "avatar"
"""The number that is a hash, and only equal or not."""


def in_turns(
    builds: Sequence[Build], warm_up: Job, job: Job, *, rounds: int, scratch: Path, says: str
) -> list[tuple[Numbers, Numbers]]:
    """Run a job in both builds, in turns; what each round told of the old one and of the new one."""
    found = []
    for number in range(rounds + 1):
        told: list[Numbers] = [{}, {}]
        print(f"{says}: {f'round {number} of {rounds}' if number else 'warming up'}", file=sys.stderr)
        # the old one first in odd rounds, the new one in even ones
        for side in (0, 1) if number % 2 else (1, 0):
            with tempfile.TemporaryDirectory(dir=scratch) as name:
                told[side] = (job if number else warm_up)(builds[side], Path(name))
        if number:
            found.append((told[0], told[1]))
    return found


def compared(rounds: Sequence[tuple[Numbers, Numbers]]) -> list[Line]:
    """The numbers that both builds told in every round.

    The hash is none of them, nor whole numbers that never change.
    """
    names = [name for name in rounds[0][0] if all(name in told for pair in rounds for told in pair)]
    lines = []
    for name in names:
        pairs = [(old[name], new[name]) for old, new in rounds]
        constant = len({value for pair in pairs for value in pair}) == 1 and pairs[0][0].is_integer()
        if name == DIGEST or constant:
            continue
        ratios = [new / old if old else float(new == old) or float("inf") for old, new in pairs]
        lines.append(
            Line(
                name,
                statistics.median(old for old, _ in pairs),
                statistics.median(new for _, new in pairs),
                statistics.median(ratios),
                min(ratios),
                max(ratios),
                statistics.median(new - old for old, new in pairs),
            )
        )
    return lines


def equal_avatars(rounds: Sequence[tuple[Numbers, Numbers]]) -> int | None:
    """In how many rounds both trained the same avatar to the bit; None where nothing was trained."""
    if not all(DIGEST in told for pair in rounds for told in pair):
        return None
    return sum(old[DIGEST] == new[DIGEST] for old, new in rounds)


def environment_in_words(config: BuildsConfig) -> str:
    """Where the libraries come from."""
    return (
        "this one for both, each build by PYTHONPATH"
        if config.reuse_environment
        else "each build's own, installed for this run"
    )


def as_object(
    config: BuildsConfig,
    builds: Sequence[Build],
    found: Mapping[str, Sequence[tuple[Numbers, Numbers]]],
    lines: Mapping[str, Sequence[Line]],
) -> dict[str, Any]:
    """All of it for a program to read."""
    return {
        **{
            side: {"revision": build.revision, "commit": build.commit, "libraries": build.libraries}
            for side, build in zip(("old", "new"), builds, strict=True)
        },
        "environment": environment_in_words(config),
        "rounds": config.rounds,
        "jobs": [
            {
                "job": says,
                "numbers": [line._asdict() for line in rows],
                "equal_avatars": equal_avatars(found[says]),
            }
            for says, rows in lines.items()
        ],
    }


def print_tables(
    config: BuildsConfig,
    builds: Sequence[Build],
    found: Mapping[str, Sequence[tuple[Numbers, Numbers]]],
    lines: Mapping[str, Sequence[Line]],
) -> None:
    """What was compared, and a Markdown table for each job."""
    for side, build in zip(("old", "new"), builds, strict=True):
        print(f"{side}: {build.revision}, {build.commit} ({build.libraries})")
    print(f"environment: {environment_in_words(config)}; rounds: {config.rounds}, in turns")
    for says, rows in lines.items():
        print(f"\n{says}\n")
        print("| | old | new | new over old | least to greatest | new less old |")
        print("|---" + "|---:" * 5 + "|")
        for line in rows:
            spread = f"{line.least:.3f} to {line.greatest:.3f}"
            ends = f"{line.ratio:.3f} | {spread} | {line.difference:+.3g}"
            print(f"| {line.what} | {line.old:.4g} | {line.new:.4g} | {ends} |")
        equal = equal_avatars(found[says])
        if equal is not None:
            print(f"\nthe same avatar to the bit in {equal} of {config.rounds} rounds")


if __name__ == "__main__":
    sys.exit(run(main, BuildsConfig, program="python tools/compare_builds.py"))
