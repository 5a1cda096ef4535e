"""The same test frames of all runs in one picture: the truth, renderings, and their errors on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from samira_warp.io.images import text_line, to_uint8
from samira_warp.stage.fitting import fitted
from samira_warp.stage.sheet import contact_sheet

STEPS = (1 / 255, 2 / 255, 4 / 255, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Where the scale of errors may end."""

SHOWN = 0.995
"""Share of the pixels whose error the scale reaches: a few at the edges would leave the rest black."""

COLORS = np.array(
    [
        (0, 0, 4),
        (40, 11, 84),
        (101, 21, 110),
        (159, 42, 99),
        (212, 72, 66),
        (245, 125, 21),
        (250, 193, 39),
        (252, 255, 164),
    ],
    np.float32,
)
"""From no error to the end of the scale, evenly spaced: matplotlib's inferno, which is CC0; its lightness
rises throughout."""


class Shown(NamedTuple):
    """One test frame of all runs.

    Attributes:
        name: The frame's.
        truth: (H, W, 3) float32 display values, None where the dataset is not there.
        renderings: (H, W, 3) uint8, one for each run.
    """

    name: str
    truth: np.ndarray | None
    renderings: tuple[np.ndarray, ...]


def errors(shown: Shown) -> list[np.ndarray]:
    """(H, W) float32 for each run: the mean absolute difference over the channels, in display values."""
    truth = shown.truth
    if truth is None:
        return []
    return [np.abs(picture.astype(np.float32) / 255.0 - truth).mean(axis=2) for picture in shown.renderings]


def end_of_scale(maps: Sequence[np.ndarray]) -> float:
    """Where one scale for all maps (H, W) ends: the first of `STEPS` that most pixels do not exceed."""
    reached = float(np.quantile(np.concatenate([each.ravel() for each in maps]), SHOWN))
    return next((step for step in STEPS if step >= reached), STEPS[-1])


def error_picture(error: np.ndarray, *, end: float) -> np.ndarray:
    """(H, W, 3) float32 display values of errors (H, W), the brightest from ``end`` on."""
    place = np.clip(error / end, 0.0, 1.0) * (len(COLORS) - 1)
    low = np.minimum(place.astype(int), len(COLORS) - 2)
    share = (place - low)[..., None].astype(np.float32)
    return ((1.0 - share) * COLORS[low] + share * COLORS[low + 1]) / 255.0


def frames_sheet(frames: Sequence[Shown], names: Sequence[str]) -> np.ndarray:
    """Two rows a frame: the truth and every run's rendering, and below them the scale and every run's errors.

    Without the truth it is one row of renderings.

    Args:
        frames: At least one; of several shapes, the smaller are laid in the middle of white.
        names: Of the runs.

    Returns:
        (H, W, 3) uint8 display values.
    """
    height, width = (max(frame.renderings[0].shape[axis] for frame in frames) for axis in (0, 1))
    maps = [errors(frame) for frame in frames]
    measured = [each for own in maps for each in own]
    end = end_of_scale(measured) if measured else None
    pictures: list[np.ndarray] = []
    labels: list[str] = []
    for frame, own in zip(frames, maps, strict=True):
        if frame.truth is not None:
            pictures.append(to_uint8(frame.truth))
            labels.append(f"{frame.name}, as filmed")
        pictures += frame.renderings
        labels += [name if own else f"{frame.name}, {name}" for name in names]
        if own and end is not None:
            pictures.append(scale_picture(end, width=width, height=height))
            labels.append("mean absolute error")
            pictures += [to_uint8(error_picture(error, end=end)) for error in own]
            labels += [
                f"{name}, L1 x 100: {100.0 * float(error.mean()):.3f}"
                for name, error in zip(names, own, strict=True)
            ]
    laid = [fitted(picture, width=width, height=height).astype(np.float32) / 255.0 for picture in pictures]
    columns = len(names) + (0 if end is None else 1)
    return to_uint8(contact_sheet(laid, labels, columns=columns))


def scale_picture(end: float, *, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: the colours of errors from 0 at the bottom to ``end``, with numbers."""
    picture = np.ones((height, width, 3), np.float32)
    bar, line = max(width // 8, 4), max(round(0.07 * height), 10)
    top, bottom = line, height - line
    ramp = np.linspace(end, 0.0, bottom - top, dtype=np.float32)[:, None]
    picture[top:bottom, bar : 2 * bar] = error_picture(np.repeat(ramp, bar, axis=1), end=end)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        middle = round(bottom - share * (bottom - top))
        strip = text_line(f"{share * end:.3f}", width=width - 2 * bar - 2, height=line)
        row = min(max(middle - line // 2, 0), height - line)
        picture[row : row + line, 2 * bar + 2 :] = strip
    return to_uint8(picture)
