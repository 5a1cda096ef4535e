"""From what a source gives to the avatar's parameters: tracked, relative to a neutral face, smoothed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.avatar import CanonicalHead, DrivingFrame
from samira_warp.data.subjects import made_subject
from samira_warp.drive.arkit import FaceSignal
from samira_warp.drive.by_pictures import TrackedDriver, middle_of
from samira_warp.drive.by_signals import SignalDriver
from samira_warp.drive.face_fit import OPENING, FaceTracker
from samira_warp.drive.one_euro import OneEuro
from samira_warp.drive.sources import FilmedPicture
from samira_warp.drive.stance import Stance
from samira_warp.head.parameters import FrameParameters
from samira_warp.vision.networks import FaceNetworks

UNITS = {"translation": 0.01, "rotations": 0.1, "expression": 0.2}
"""Steps of the smoothing: metres, radians, coefficients."""


@dataclass(frozen=True)
class DriveSettings:
    """How a source drives an avatar.

    Attributes:
        neutral: Number of the frame whose face is neutral; None for the first pictures of a face, and for
            signals for zeros, which are ARKit's own neutral face.
        smoothing: 0 for none, 1 as is usual; the cutoff at rest goes with its inverse.
        gain: Factor on the expression.
        clamp: Hold the pose to what was seen in training.
    """

    neutral: int | None = None
    smoothing: float = 1.0
    gain: float = 1.0
    clamp: bool = True


class Seen(NamedTuple):
    """A frame of a source before it is the avatar's.

    Attributes:
        number: From 0.
        seconds: When it was.
        face: The tracked head or the signal; None where no face is seen.
        reason: Why none is, else "".
    """

    number: int
    seconds: float
    face: FrameParameters | FaceSignal | None
    reason: str = ""


class Performance(NamedTuple):
    """A frame of a source as the avatar's.

    Attributes:
        number: From 0.
        seconds: When it was.
        parameters: The avatar's, float32 on the CPU.
        reason: Why they are those of the frame before, else "".
    """

    number: int
    seconds: float
    parameters: FrameParameters
    reason: str = ""


class Performer:
    """Drives one avatar by one source; `see` and `perform` are called in order, from one thread."""

    def __init__(
        self,
        canonical: CanonicalHead,
        frames: Sequence[DrivingFrame],
        settings: DriveSettings,
        *,
        pictures: bool,
    ) -> None:
        """Prepare.

        Args:
            canonical: The avatar's head.
            frames: Those that it was made from.
            settings: How it is driven.
            pictures: Whether the source gives pictures; else signals.

        Raises:
            UserError: The networks cannot be had, or the avatar's head can be matched with no tracked one.
        """
        template = canonical.template
        self.stance = Stance.of(template, frames, canonical.shape)
        self._settings, self._count = settings, 0
        self._latest: Seen | None = None
        self._tracker: FaceTracker | None = None
        if pictures:
            # an avatar whose head has no landmarks is driven by one that has, by the names of expressions
            tracked = template if template.landmarks is not None else made_subject().head()
            self._by_pictures = TrackedDriver(tracked, template, gain=settings.gain)
            self._tracker = FaceTracker(tracked, FaceNetworks.load())
        else:
            self._by_signals = SignalDriver(template, gain=settings.gain)
            _say_map(self._by_signals)
        rest = self.stance.rest
        units = [np.full(getattr(rest, name).numel(), unit) for name, unit in UNITS.items()]
        self._filter = OneEuro(np.concatenate(units), smoothing=settings.smoothing)
        self._held = rest

    def see(self, item: FilmedPicture | FaceSignal) -> list[Seen]:
        """Take the next of a source: nothing while the first pictures are waited for, then all of them."""
        if isinstance(item, FaceSignal):
            number, self._count = self._count, self._count + 1
            return [Seen(number, item.seconds, item)]
        assert self._tracker is not None
        return self._found([Seen(*one) for one in self._tracker.look(*item)])

    def close(self) -> list[Seen]:
        """What was still waited for when the source ended."""
        if self._tracker is None:
            return []
        return self._found([Seen(*one) for one in self._tracker.close()])

    def take_for_neutral(self, seen: Seen | None = None) -> None:
        """Take a frame's face, or the newest one, for the neutral one from now on."""
        face = (seen or self._latest or Seen(0, 0.0, None)).face
        if isinstance(face, FaceSignal):
            self._by_signals.take_for_neutral(face)
        elif face is not None:
            assert self._tracker is not None
            self._by_pictures.take_for_neutral(face, self._tracker.shape)

    def perform(self, seen: Seen) -> Performance:
        """The avatar's parameters of a frame; those of the last one where it shows no face."""
        if seen.face is None or (self._tracker is not None and not self._by_pictures.ready):
            return Performance(seen.number, seen.seconds, self._held, seen.reason)
        self._latest = seen
        if seen.number == self._settings.neutral:
            self.take_for_neutral(seen)
        face = (
            self._by_signals.face(seen.face)
            if isinstance(seen.face, FaceSignal)
            else self._by_pictures.face(seen.face)
        )
        parameters = self.stance.pose(face, clamp=self._settings.clamp)
        self._held = self._smoothed(seen.seconds, parameters)
        return Performance(seen.number, seen.seconds, self._held)

    def _found(self, seen: list[Seen]) -> list[Seen]:
        """Let the first faces be the neutral one, until another is."""
        faces = [one.face for one in seen if isinstance(one.face, FrameParameters)]
        if faces and not self._by_pictures.ready:
            assert self._tracker is not None
            self._by_pictures.take_for_neutral(middle_of(faces[:OPENING]), self._tracker.shape)
        return seen

    def _smoothed(self, seconds: float, parameters: FrameParameters) -> FrameParameters:
        values = [getattr(parameters, name) for name in UNITS]
        flat = torch.cat([value.flatten() for value in values]).double().numpy()
        filtered = torch.from_numpy(self._filter(seconds, flat)).float()
        parts = filtered.split([value.numel() for value in values])
        shaped = [part.view(value.shape) for part, value in zip(parts, values, strict=True)]
        return replace(parameters, **dict(zip(UNITS, shaped, strict=True)))


def _say_map(driver: SignalDriver) -> None:
    found = driver.map
    print(f"note: the avatar takes {found.said}", file=sys.stderr)
    if found.missing:
        print(f"note: it has nothing for {', '.join(found.missing)}", file=sys.stderr)
