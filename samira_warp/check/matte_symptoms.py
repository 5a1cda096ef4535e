"""The usual mistakes, known by how a tracked head lies on the matte of its picture.

A matte covers a person: hair and shoulders as well as the head, so that the head should lie in it and not
fill it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from samira_warp.check.findings import OTHER_FLAME, Finding
from samira_warp.check.views import View, coverage, faces_before, project, silhouette
from samira_warp.data import Frame, TrackedSequence

_INSIDE = 0.7
"""Share of a head's silhouette that lies in the matte where tracking and camera are right; rough tracking has
0.9."""

_FILLED = 0.15
"""Share of the matte that the head covers at least, in all that either covers: of a person to the waist it is
about this."""

_OTHER_SCALE = 4.0
"""IMavatar's heads, and those of HRAvatar's first version, are this many times as large as in metres."""


class _Case(NamedTuple):
    """A head and a matte on one grid."""

    view: View
    faces: np.ndarray
    matte: np.ndarray

    def agree(self, *, distance: float = 1.0) -> bool:
        """Whether the head lies in the matte when the camera's distance is multiplied."""
        head, matte = self.head(distance), self.matte > 0.5
        shared = np.count_nonzero(head & matte)
        return bool(
            shared >= _INSIDE * np.count_nonzero(head)
            and shared >= _FILLED * np.count_nonzero(head | matte) > 0
        )

    def head(self, distance: float = 1.0) -> np.ndarray:
        """(h, w) bool silhouette."""
        camera, (height, width) = self.view.frame.camera, self.matte.shape
        points = self.view.points + (distance - 1.0) * camera.world_to_camera[:3, 3].numpy()
        pixels = project(points, self.view.frame) * [width / camera.width, height / camera.height]
        return silhouette(pixels, faces_before(points, self.faces), width=width, height=height)

    def share_inside(self) -> float:
        """Share of the head's silhouette that is in the matte."""
        head = self.head()
        return float(np.count_nonzero(head & (self.matte > 0.5)) / max(int(np.count_nonzero(head)), 1))


class _Mistake(NamedTuple):
    """What is said of a mistake."""

    severity: Literal["fault", "warning"]
    where: Callable[[Frame], Path]
    expected: str
    found: str
    remedy: str


def _pictures(frame: Frame) -> Path:
    return (frame.mask_path or frame.image_path).parent


def _tracked(frame: Frame) -> Path:
    return frame.parameters_path if frame.parameters_path.suffix == ".json" else frame.parameters_path.parent


_MISTAKES = {
    "inverted": _Mistake(
        "fault", _pictures, "masks that are white on the head", "black on it", "invert the masks"
    ),
    "large": _Mistake(
        "fault",
        _tracked,
        "the head as large as its mask",
        "about four times as large",
        "the camera's distance looks divided by four: write lengths in metres, "
        "or give the file the name of its version",
    ),
    "small": _Mistake(
        "fault",
        _tracked,
        "the head as large as its mask",
        "about a quarter as large",
        "the camera's distance looks like that of a head four times as large: "
        "divide it by four to have metres",
    ),
    "turned": _Mistake(
        "fault",
        _pictures,
        "pictures that are upright where the tracked heads are",
        "upside down",
        "turn the pictures as they were when they were tracked",
    ),
    "elsewhere": _Mistake(
        "warning",
        _pictures,
        "the tracked head within its mask",
        "beside it",
        "look at the contact sheet: were the pictures cropped or scaled after they were tracked? "
        f"Else {OTHER_FLAME}",
    ),
}


def matte_symptoms(sequence: TrackedSequence, views: list[View]) -> Iterator[Finding]:
    """What at least half of the mattes say; nothing where there are none."""
    mattes = [(view, coverage(view)) for view in views]
    cases = [_Case(view, sequence.template.faces, matte) for view, matte in mattes if matte is not None]
    said = Counter(name for name in map(_mistake, cases) if name is not None)
    if not said or 2 * said.total() < len(cases):
        return
    name, count = said.most_common(1)[0]
    if 2 * count < said.total():
        name, count = "elsewhere", said.total()
    mistake = _MISTAKES[name]
    in_frames = f"{mistake.found} in {count} of {len(cases)} frames looked at"
    yield Finding(
        mistake.severity, str(mistake.where(cases[0].view.frame)), mistake.expected, in_frames, mistake.remedy
    )


def _mistake(case: _Case) -> str | None:
    """Which mistake makes head and matte disagree; None where they agree."""
    if case.agree():
        return None
    if _covers_the_border(case.matte) and case._replace(matte=1.0 - case.matte).agree():
        return "inverted"
    for name, distance in (("large", _OTHER_SCALE), ("small", 1.0 / _OTHER_SCALE)):
        if case.agree(distance=distance):
            return name
    if case._replace(matte=case.matte[::-1, ::-1]).agree():
        return "turned"
    return "elsewhere" if case.share_inside() < _INSIDE else None


def _covers_the_border(matte: np.ndarray) -> bool:
    """Whether most of the upper border is covered, where a person is not: shoulders leave it below."""
    upper = matte[: max(matte.shape[0] // 2, 1)] > 0.5
    return bool(np.concatenate([upper[0], upper[:, 0], upper[:, -1]]).mean() > 0.5)
