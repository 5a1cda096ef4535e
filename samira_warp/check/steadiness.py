"""How steadily a tracked head moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from samira_warp.check.grades import Grade, word_of, worst_of
from samira_warp.check.motion import HeadMotion

JITTER_GOOD, JITTER_FAIR = 0.001, 0.003
"""Standard deviations of a point from one frame to the next, in the head's height: a quarter of a pixel of a
head of 256, below what resampling a film does, and three quarters, where what is painted on it swims."""

SWING = 0.2
"""What a point that swings as fast as heads shake, four times a second in 25 frames, seems to jitter by, in
its motion from frame to frame: that much is no jitter."""

FASTEST = 0.1
"""Motion from frame to frame, in the head's height, above which frames are no film: half a metre a second in
25 frames, and more most of the time."""

LEAST_WINDOWS = 6
"""Places at which jitter is measured before anything is said of it."""

THIRD_DIFFERENCE = 20.0
"""Variance of x[t+3] - 3 x[t+2] + 3 x[t+1] - x[t] of independent x, in theirs: 1 + 9 + 9 + 1."""


def grade_steadiness(motion: HeadMotion) -> Grade | None:
    """How much the head jitters; None where too few frames follow one another closely enough to tell.

    A point that moves smoothly is seen at places whose third difference is next to nothing; one that is off
    by chance in every frame, by a standard deviation s, has third differences of sqrt(20) s. Differences of
    second order, which are often taken, count every turn of a head as jitter.
    """
    windows = [_Windows.of(motion, run) for run in motion.runs if len(run) >= _WINDOW]
    if sum(len(some.jitter) for some in windows) < LEAST_WINDOWS:
        return None
    of_frames: dict[str, list[float]] = {}
    for some in windows:
        for place, value in enumerate(some.jitter.tolist()):
            for frame in some.run[place : place + _WINDOW]:
                of_frames.setdefault(motion.names[frame], []).append(value)
    # one bad frame is in all of its windows, and the frames beside it are in others as well
    frames = {name: min(values) for name, values in of_frames.items()}
    pixels, share, degrees, move, pace = (
        float(np.median(np.concatenate(values))) for values in list(zip(*windows, strict=True))[1:]
    )
    if pace > FASTEST:
        return None
    word = word_of(share, good=JITTER_GOOD, fair=JITTER_FAIR)
    said = f"steady to {pixels:.2f} pixels" if word == "good" else f"it jitters by {pixels:.1f} pixels"
    moves = f"where it moves by {move:.1f} pixels a frame"
    text = f"{said} and {degrees:.2f} degrees, {moves}; {worst_of(frames)}"
    overall = {
        "jitter_pixels": pixels,
        "jitter_share_of_height": share,
        "jitter_degrees": degrees,
        "motion_pixels": move,
        "frames": len(frames),
    }
    return Grade("steadiness", word, text, overall, frames)


_WINDOW = 4
"""Frames of a third difference."""


class _Windows(NamedTuple):
    """What is measured in each window of a run of frames.

    Attributes:
        run: Indices of the frames.
        jitter: (W,) pixels.
        share: (W,) the same in the head's height.
        degrees: (W,) jitter of the head's turn.
        motion: (W,) pixels from frame to frame.
        pace: (W,) the same in the head's height.
    """

    run: np.ndarray
    jitter: np.ndarray
    share: np.ndarray
    degrees: np.ndarray
    motion: np.ndarray
    pace: np.ndarray

    @classmethod
    def of(cls, motion: HeadMotion, run: np.ndarray) -> _Windows:
        """Measure a run of at least `_WINDOW` frames."""
        points = motion.points[run].reshape(len(run), -1)
        jitter, moved = _beyond_swing(points)
        # a turn by a small angle moves the nine entries of a rotation by sqrt(2) times that, all together
        turn = _beyond_swing(motion.rotations[run].reshape(len(run), 9))[0] * np.sqrt(9.0 / 2.0)
        heights, moved = motion.heights[run][1:-2], np.sqrt(2.0) * moved  # of a point, in two axes
        return cls(run, jitter, jitter / heights, np.rad2deg(turn), moved, moved / heights)


def _beyond_swing(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(W,) standard deviation from frame to frame of (N, D) coordinates, and (W,) their motion.

    Both are root mean squares over D.
    """
    third = np.square(np.diff(places, 3, axis=0)).mean(axis=1) / THIRD_DIFFERENCE
    steps = np.square(np.diff(places, axis=0)).mean(axis=1)
    motion = (steps[:-2] + steps[1:-1] + steps[2:]) / 3.0
    return np.sqrt(np.maximum(third - SWING**2 * motion, 0.0)), np.sqrt(motion)
