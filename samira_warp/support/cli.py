"""What every verb's command line shares: typed options, and one line instead of a traceback for a mistake."""

from __future__ import annotations

import contextlib
import difflib
import io
import itertools
import os
import re
import select
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from samira_warp.support.errors import UserError, in_words
from samira_warp.support.memory import keep_freed_memory

Config = TypeVar("Config")

STATUS_MISTAKE = 2
"""Exit status for input that cannot be used or output that cannot be written, and for a wrong option."""

STATUS_INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

STATUS_READER_GONE = 141
"""Exit status where nobody reads standard output any more (``... | head -1``), as shells have it."""


def run(
    main: Callable[[Config], None],
    config_type: type[Config],
    *,
    program: str,
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the command line into ``config_type`` and run ``main`` with it.

    Args:
        main: The verb. What it needs it imports when it is called, so that help and wrong options come at
            once.
        config_type: A dataclass whose docstring describes the verb and whose fields are its options.
        program: How the verb is called, for the help, such as "python -m samira_warp.train".
        arguments: The options instead of those of the process.

    Returns:
        The exit status: 0; 2 after one line on standard error, for a user's mistake or a file that cannot be
        read or written; 130 after Ctrl-C; 141 where standard output was closed.
    """
    keep_freed_memory()
    words = list(sys.argv[1:] if arguments is None else arguments)
    return guarded(lambda: main(_parse(config_type, program, words)), options=_bare_names(config_type))


def guarded(work: Callable[[], None], *, options: Sequence[str] = ()) -> int:
    """Run ``work`` and give its exit status, as `run` says.

    Args:
        work: What to do.
        options: Names that stand for options in messages: they are shown with their dashes.
    """
    try:
        try:
            work()
            status = 0
        except UserError as mistake:
            text = str(mistake)
            if mistake.subject in options:
                text = f"--{mistake.subject.replace('_', '-')}{text.removeprefix(mistake.subject)}"
            status = say_mistake(text)
        except KeyboardInterrupt:
            status = STATUS_INTERRUPTED
        finally:
            sys.stdout.flush()
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _reader_is_gone():
            return STATUS_READER_GONE
        return say_mistake(in_words(error))
    return status


def say_mistake(text: str) -> int:
    """Print one line on standard error; the exit status for it."""
    print(f"error: {' '.join(text.split())}", file=sys.stderr)
    return STATUS_MISTAKE


def fault(config_type: type, words: Sequence[str]) -> str | None:
    """What is wrong with the words of a verb's command line, None where nothing is."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            _parse(config_type, "", list(words))
    except SystemExit:
        return said.getvalue().strip().removeprefix("error: ").rpartition("; see ")[0]
    return None


def nearest(word: str, names: Sequence[str]) -> str | None:
    """The name that a mistyped word is likely to mean, None where it is like none of them."""
    return next(iter(difflib.get_close_matches(word, names, n=1)), None)


def _parse(config_type: type[Config], program: str, words: list[str]) -> Config:
    """The options as ``config_type``.

    A wrong one ends the process with status 2, and with one line where tyro draws a box.
    """
    import tyro  # a tenth of a second, which `samira-warp --help` need not wait for

    unknown = _unknown_option(config_type, words)
    if unknown is not None:
        raise SystemExit(say_mistake(f"{unknown}; see {program} --help"))
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(config_type, prog=program, args=words)
    except SystemExit as end:
        if end.code:
            paragraph = _with_choices_in_order(_first_paragraph(said.getvalue()), config_type)
            say_mistake(f"{paragraph}; see {program} --help")
        raise


def _unknown_option(config_type: type, words: list[str]) -> str | None:
    """What to say of the first word that looks like an option and is none, with the one that is nearest."""
    if {"-h", "--help"} & set(words):
        return None
    names = _option_names(config_type)
    for word in words:
        name = word.partition("=")[0].replace("_", "-")
        if not re.match(r"--[A-Za-z]", name) or name in names or name.startswith("--tyro-"):
            continue
        negated = name.startswith("--no-")
        meant = nearest(
            name[2:].lower(), [other[2:] for other in names if other.startswith("--no-") == negated]
        )
        return f"unknown option {name}" + ("" if meant is None else f", did you mean --{meant}?")
    return None


def _option_names(config_type: type) -> list[str]:
    """Every option of a configuration as it is typed, those of two values with their opposites."""
    from tyro.conf import Positional

    marker = get_args(Positional[int])[1]
    names = []
    for name, hint in get_type_hints(config_type, include_extras=True).items():
        if marker not in get_args(hint):
            option = name.replace("_", "-")
            names += [f"--{option}"] + [f"--no-{option}"] * (bool in (hint, *_parts(hint)))
    return names


def _parts(hint: Any) -> list[Any]:
    """What a hint is put together from, types and the values of literals, in order."""
    return [part for inner in get_args(hint) for part in (inner, *_parts(inner))]


def _bare_names(config_type: type) -> list[str]:
    """Fields whose name alone, as the subject of a message, means the option.

    A path may itself be called as its option is.
    """
    hints = get_type_hints(config_type)
    return [
        field.name
        for field in fields(config_type)
        if Path not in (hints[field.name], *_parts(hints[field.name]))
    ]


def _first_paragraph(box: str) -> str:
    """The words of a box of text up to its first rule or empty line, without the frame."""
    lines = [line.strip("│╭╮╰╯ \t") for line in box.splitlines()]
    paragraph = itertools.takewhile(
        lambda line: line.strip("─ "), itertools.dropwhile(lambda line: "─" in line, lines)
    )
    return " ".join(" ".join(paragraph).split()).removesuffix(".")


def _with_choices_in_order(text: str, config_type: type) -> str:
    """A message about a wrong choice with the right ones as they are declared: tyro has them in a set."""
    declared = [str(part) for hint in get_type_hints(config_type).values() for part in _parts(hint)]

    def ordered(choices: re.Match[str]) -> str:
        named = [name for name in re.findall(r"'([^']*)'", choices[0]) if name in declared]
        return f"({', '.join(map(repr, sorted(named, key=declared.index)))})"

    return re.sub(r"(?<=Expected one of )\([^)]*\)", ordered, text)


def _reader_is_gone() -> bool:
    """Whether standard output is a pipe that nobody reads; if so, what is still to be written is dropped."""
    try:
        descriptor = sys.stdout.fileno()
    except (OSError, ValueError):  # it is no file
        return False
    if hasattr(select, "poll"):
        poll = select.poll()
        poll.register(descriptor, 0)
        if not any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0)):
            return False
    # the interpreter flushes once more at its end, and would complain
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
    return True
