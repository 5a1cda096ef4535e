"""How many pixels a picture has: few while something moves, all of the window when it rests."""

from __future__ import annotations

LEAST, MOST = 256, 512
"""Longer side while something moves, pixels."""

STEP = 32
"""What sides are multiples of, so that they do not change with every picture."""

WANTED = 1.0 / 15.0
"""Seconds that a picture may take while something moves."""


class MovingSize:
    """The size at which pictures are quick enough, from how long the last ones took."""

    def __init__(self) -> None:
        self._side = float(MOST)

    @property
    def side(self) -> int:
        """Pixels along the longer side."""
        return int(self._side // STEP) * STEP

    def took(self, seconds: float) -> None:
        """Learn from a picture of this size: the time goes with the area, and no step is a large one."""
        factor = (WANTED / max(seconds, 1e-6)) ** 0.5
        self._side = min(max(self._side * min(max(factor, 0.8), 1.1), LEAST), MOST)


def fit(width: int, height: int, *, longer: int) -> tuple[int, int]:
    """Width and height of a picture for a window of a size, with no more than so many pixels along a side."""
    scale = min(longer / max(width, height, 1), 1.0)
    return max(round(width * scale), 1), max(round(height * scale), 1)
