"""What other people's libraries do when they do not do what they are asked."""

from __future__ import annotations

import sys

FAILURES = (
    AssertionError,
    AttributeError,
    ImportError,
    KeyError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What one of another version, or one that is half installed, raises."""


def say_left_out(name: str, error: Exception) -> None:
    """One line on standard error: why a library is left out of a comparison."""
    print(f"{name} left out: {type(error).__name__} {' '.join(str(error).split())}", file=sys.stderr)
