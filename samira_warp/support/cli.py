"""What every verb's command line shares.

Typed options, and one line instead of a traceback for a user's mistake.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from samira_warp.support.errors import UserError
from samira_warp.support.memory import keep_freed_memory

Config = TypeVar("Config")

STATUS_MISTAKE = 2
"""Exit status for input that cannot be used or output that cannot be written, and for a wrong option."""

STATUS_INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def run(
    main: Callable[[Config], None],
    config_type: type[Config],
    *,
    program: str,
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the command line into ``config_type`` and run ``main`` with it.

    Args:
        main: The verb.
        config_type: A dataclass whose docstring describes the verb and whose fields are its options.
        program: How the verb is called, for the help, such as "python -m samira_warp.train".
        arguments: The options instead of those of the process.

    Returns:
        The exit status: 0; 2 after one line on standard error, for a user's mistake or a file that cannot be
        written; 130 after Ctrl-C.
    """
    keep_freed_memory()
    try:
        main(_parse(config_type, program, arguments))
    except (UserError, OSError) as mistake:
        print(f"error: {' '.join(str(mistake).split())}", file=sys.stderr)
        return STATUS_MISTAKE
    except KeyboardInterrupt:
        return STATUS_INTERRUPTED
    return 0


def _parse(config_type: type[Config], program: str, arguments: Sequence[str] | None) -> Config:
    """The options as ``config_type``.

    A wrong one ends the process with status 2, and with one line where tyro draws a box.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(config_type, prog=program, args=arguments)
    except SystemExit as end:
        if end.code:
            print(f"error: {_first_paragraph(said.getvalue())}; see {program} --help", file=sys.stderr)
        raise


def _first_paragraph(box: str) -> str:
    """The words of a box of text up to its first rule or empty line, without the frame."""
    lines = [line.strip("│╭╮╰╯ \t") for line in box.splitlines()]
    paragraph = itertools.takewhile(
        lambda line: line.strip("─ "), itertools.dropwhile(lambda line: "─" in line, lines)
    )
    return " ".join(" ".join(paragraph).split()).removesuffix(".")
