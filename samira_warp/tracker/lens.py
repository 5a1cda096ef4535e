"""What a focal length is taken for where nothing says it."""

from __future__ import annotations

TYPICAL = 1.2
"""Focal length in longer sides of the picture where nothing is known: telephones film with 0.7 to 1.0,
cameras on a stand with 1.4 to 2.4."""

SQUARE = 2.4
"""The same of square films: no camera makes them, they were cut out of one of about twice their side."""


def guessed_focal(width: int, height: int) -> float:
    """Pixels, of a picture of a size."""
    return (SQUARE if width == height else TYPICAL) * max(width, height)
