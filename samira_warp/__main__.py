"""``samira-warp VERB ...``, or ``python -m samira_warp VERB ...``: one command before all verbs."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from samira_warp import __version__
from samira_warp.support.cli import guarded, nearest, say_mistake

VERBS = {
    "prepare": "make a dataset of a video of one head",
    "check": "say what a dataset holds and all that is wrong with it",
    "train": "train a relightable, animatable avatar from a tracked video",
    "render": "render an avatar, re-animated, relit, its materials changed",
    "view": "look at an avatar in the browser: move it, light it, change it",
    "evaluate": "score images against a dataset",
    "export": "write an avatar for other programs",
    "fleet": "do many subjects on many machines, from their films to their scores",
    "ablate": "train the method without each of its parts, and compare",
    "compare": "put training runs side by side in a report",
    "bench": "time a part of the package on this machine",
}
"""What each verb does, in the order in which they are used."""

PROGRAM = "samira-warp"


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the first word says.

    Args:
        arguments: The words after ``samira-warp`` instead of those of the process.

    Returns:
        The exit status, as `samira_warp.support.cli.run` gives it.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    first = words[0] if words else None
    if first in VERBS:
        verb = importlib.import_module(f"samira_warp.{first}.__main__")
        return verb.command(words[1:], program=f"{PROGRAM} {first}")
    if first in ("-h", "--help"):
        return guarded(lambda: print(_help()))
    if first == "--version":
        return guarded(lambda: print(f"{PROGRAM} {__version__}"))
    return say_mistake(f"{_complaint(first)}; see {PROGRAM} --help")


def _help() -> str:
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {what}" for verb, what in VERBS.items()]
    return "\n".join(
        [
            f"usage: {PROGRAM} VERB [OPTIONS]",
            "",
            "A video of a head in, a relightable, animatable Gaussian avatar out.",
            "",
            *lines,
            "",
            f"{PROGRAM} VERB --help shows its options, {PROGRAM} --version the version.",
        ]
    )


def _complaint(word: str | None) -> str:
    """What is wrong with the first word."""
    if word is None:
        return f"expected a verb, one of {', '.join(VERBS)}"
    meant = nearest(word, list(VERBS))
    return f"{word} is none of the verbs {', '.join(VERBS)}" + (
        "" if meant is None else f", did you mean {meant}?"
    )


if __name__ == "__main__":
    sys.exit(main())
