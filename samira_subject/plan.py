"""What is made of the built-in subject: how much, and picture by picture."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE, SKIES
from samira_warp.support.errors import UserError

VERSION = 1
"""Rises with every change that changes a pixel or a parameter of the subject."""

SIZE = 256
"""Width and height of the pictures, pixels."""

TEXELS = 1024
"""Width and height of the painted maps: about two texels a pixel at SIZE."""

LIGHTS = (CAPTURE, *(name for name in SKIES if name != CAPTURE))
"""The light of most pictures, and the others, in the order that numbers their rays."""


@dataclass(frozen=True)
class SubjectPlan:
    """What is made.

    Attributes:
        seed: Seed of every choice: whose head it is, what it does, and how rays are cast.
        train: Frames to train on.
        test: Frames to test on, which follow.
        relit: How many of those are taken under each of the other lights as well.
        size: Width and height of the pictures, pixels.
        texels: Width and height of the painted maps.
        effort: How many rays.
        lights: Names of the light of most pictures, and of the others.

    Raises:
        UserError: A number is too small, or two lights have one name.
    """

    seed: int = 0
    train: int = 160
    test: int = 40
    relit: int = 10
    size: int = SIZE
    texels: int = TEXELS
    effort: Effort = field(default_factory=Effort)
    lights: tuple[str, ...] = LIGHTS

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("train", 1), ("test", 1), ("relit", 0), ("size", 1), ("texels", 1)):
            if getattr(self, name) < least:
                raise UserError(name, expected=f"at least {least}", found=getattr(self, name))
        if not self.lights or len(set(self.lights)) < len(self.lights):
            raise UserError("lights", expected="lights of different names", found=", ".join(self.lights))

    @property
    def capture(self) -> str:
        """The light of most pictures."""
        return self.lights[0]

    def recipe(self, digests: Sequence[str] = ()) -> str:
        """A hash of all that decides the bytes of the dataset; ``digests`` are those of a user's lights."""
        return hashlib.sha256(json.dumps([VERSION, asdict(self), *digests]).encode()).hexdigest()[:12]

    def takes(self) -> list[Take]:
        """Every picture to take, those of a frame after one another."""
        step = max(self.test // max(self.relit, 1), 1)
        relit = range(self.train, self.train + min(step * self.relit, self.test), step)
        taken = []
        for frame in range(self.train + self.test):
            truth = ("albedo",) if frame < self.train else ("gt/albedo", "gt/normal")
            taken.append(Take(frame, self.capture, ("images", "fg_masks", *truth)))
            others = self.lights[1:] if frame in relit else ()
            taken += [Take(frame, light, (f"gt/relight/{light}",)) for light in others]
        return taken


class Take(NamedTuple):
    """One picture to take.

    Attributes:
        frame: Which frame it shows.
        light: One of the plan's lights.
        layers: Folders within the dataset into each of which a file of it goes.
    """

    frame: int
    light: str
    layers: tuple[str, ...]

    @property
    def file(self) -> str:
        """The name of its file in each of the folders."""
        return f"{self.frame:05d}_00.png"

    def is_in(self, folder: Path) -> bool:
        """Whether a dataset has all its files."""
        return all((folder / layer / self.file).exists() for layer in self.layers)
