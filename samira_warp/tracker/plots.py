"""A tracking over time, as curves: pose, what opens and closes, and how far the fit is off."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from samira_warp.io.files import replace_file
from samira_warp.support.errors import UserError

_INCHES = (10.0, 8.0)
_DPI = 100


def write_plots(
    path: Path,
    *,
    seconds: np.ndarray,
    angles: np.ndarray,
    translation: np.ndarray,
    openness: Mapping[str, np.ndarray],
    error: Mapping[str, np.ndarray],
) -> None:
    """Draw the curves of a tracking as a PNG: 1000 x 800 pixels, four panels over one axis of time.

    Where a value is NaN its curve has a gap.

    Args:
        path: Where to write it.
        seconds: (N,) times of the frames.
        angles: (N, 3) the head's pitch, yaw and roll, degrees.
        translation: (N, 3) the head's place: to the right, up, and towards the camera, metres.
        openness: (N,) how far something is open, 0 to 1, by its name: eyes, mouth.
        error: (N,) pixels by which a fit is off, by the stage's name.

    Raises:
        UserError: Matplotlib is not installed, an array has another shape, or there is no room for the file.
    """
    _check(seconds, {"angles": angles, "translation": translation}, columns=3)
    _check(seconds, {**openness, **error}, columns=None)
    curves = {
        "degrees": dict(zip(("pitch", "yaw", "roll"), angles.T, strict=True)),
        "centimetres": dict(zip(("right", "up", "forward"), 100.0 * translation.T, strict=True)),
        "open": openness,
        "error, pixels": error,
    }
    figure = _figure()
    panels = figure.subplots(len(curves), 1, sharex=True)
    for panel, (unit, named) in zip(panels, curves.items(), strict=True):
        for name, values in named.items():
            panel.plot(seconds, values, linewidth=1.2, label=name)
        panel.set_ylabel(unit)
        panel.grid(alpha=0.3)
        if named:
            panel.legend(loc="upper right", fontsize="small", ncols=len(named))
    panels[2].set_ylim(-0.05, 1.05)
    panels[3].set_ylim(bottom=0.0)
    panels[3].set_xlabel("seconds")
    content = io.BytesIO()
    figure.savefig(content, format="png")
    replace_file(path, content.getvalue())


def _figure() -> Any:
    """An empty figure that belongs to no window, and to no list of matplotlib's own."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UserError(
            "matplotlib", expected="what draws curves (pip install 'samira-warp[track]')", found=error
        ) from error
    return Figure(figsize=_INCHES, dpi=_DPI, layout="constrained")


def _check(seconds: np.ndarray, arrays: Mapping[str, np.ndarray], *, columns: int | None) -> None:
    shape = seconds.shape if columns is None else (*seconds.shape, columns)
    for name, array in arrays.items():
        if array.shape != shape:
            raise UserError(name, expected=f"an array of shape {shape}", found=f"{array.shape}")
