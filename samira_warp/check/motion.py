"""A tracked head in all its frames: where points of it are seen, and how it turns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from samira_warp.check.views import View, project, views_of
from samira_warp.data import TrackedSequence

POINTS = 200
"""Vertices whose motion stands for the head's."""


@dataclass(frozen=True, eq=False)
class HeadMotion:
    """The head in N frames, by timestep and name.

    Attributes:
        names: Their names.
        points: (N, P, 2) float64 pixels of some vertices, the same in every frame.
        landmarks: (N, L, 2) float64 pixels of the template's landmarks; none where it has none.
        rotations: (N, 3, 3) float64 from the head to the camera.
        heights: (N,) float64 of the head in the picture, pixels.
        runs: Indices of frames that follow one another at the sequence's own pace, before one camera.
    """

    names: tuple[str, ...]
    points: np.ndarray
    landmarks: np.ndarray
    rotations: np.ndarray
    heights: np.ndarray
    runs: tuple[np.ndarray, ...]


def head_motion(sequence: TrackedSequence, indices: Sequence[int]) -> HeadMotion:
    """Pose and project the head in the frames with ``indices``, at least one."""
    vertices = len(sequence.template.v_template)
    chosen = np.unique(np.linspace(0, vertices - 1, POINTS).round().astype(int))
    points, marks, rotations, heights = [], [], [], []
    for view in views_of(sequence, indices):
        points.append(view.pixels[chosen])
        marks.append(fitted_landmarks(view, sequence))
        rotations.append(view.rotation)
        heights.append(np.ptp(view.pixels[:, 1]))
    return HeadMotion(
        names=tuple(sequence.frames[index].name for index in indices),
        points=np.stack(points),
        landmarks=np.stack(marks),
        rotations=np.stack(rotations),
        heights=np.array(heights),
        runs=_runs([sequence.frames[index].timestep for index in indices]),
    )


def fitted_landmarks(view: View, sequence: TrackedSequence) -> np.ndarray:
    """(L, 2) pixels of the template's landmarks on a tracked head; none where it has none."""
    template = sequence.template
    if template.landmarks is None:
        return np.zeros((0, 2))
    return project(template.landmarks.points(view.points, template.faces), view.frame)


def _runs(timesteps: Sequence[int]) -> tuple[np.ndarray, ...]:
    """Runs of frames whose timesteps are one usual step apart, of ascending timesteps.

    Of several frames of one timestep, the first is the first camera's, and so on.
    """
    seen: Counter[int] = Counter()
    by_camera: dict[int, list[int]] = {}
    for index, timestep in enumerate(timesteps):
        by_camera.setdefault(seen[timestep], []).append(index)
        seen[timestep] += 1
    runs = []
    for frames in by_camera.values():
        steps = np.diff([timesteps[frame] for frame in frames])
        if len(steps):
            usual = Counter(steps.tolist()).most_common(1)[0][0]
            runs += np.split(np.array(frames), np.flatnonzero(steps != usual) + 1)
    return tuple(runs)
