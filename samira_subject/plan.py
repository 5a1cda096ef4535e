"""What is made of the built-in subject: how much, and picture by picture."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from samira_subject.lights import LAMP
from samira_subject.orbit import POSES, VIEWS, View, view_name
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE, SKIES
from samira_warp.support.errors import UserError

VERSION = 2
"""Rises with every change that changes a pixel or a parameter of the subject, or what is beside them."""

SIZE = 256
"""Width and height of the pictures, pixels."""

TEXELS = 1024
"""Width and height of the painted maps: about two texels a pixel at SIZE."""

LIGHTS = (CAPTURE, *(name for name in SKIES if name != CAPTURE), LAMP)
"""The light of most pictures, and the others, in the order that numbers their rays."""


SURFACE_LAYERS = ("gt/albedo", "gt/normal", "gt/roughness", "gt/specular")
"""What is written of the surface that a test frame shows."""

HIDDEN_FILE = "gt/hidden_motion.npz"
"""What moves as the tracks do not say, in metres of the world, a row a frame."""

ORBIT = "gt/orbit"
"""The folder of the pictures from all around, a dataset of its own."""


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
        hidden: Whether it moves as well as its template has no shapes for (`hidden_motion`).
        orbit: From where the held poses are filmed; the first is straight ahead, and none films no orbit.

    Raises:
        UserError: A number is too small, two lights have one name, or the orbit begins elsewhere.
    """

    seed: int = 0
    train: int = 160
    test: int = 40
    relit: int = 10
    size: int = SIZE
    texels: int = TEXELS
    effort: Effort = field(default_factory=Effort)
    lights: tuple[str, ...] = LIGHTS
    hidden: bool = False
    orbit: tuple[View, ...] = VIEWS

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("train", 1), ("test", 1), ("relit", 0), ("size", 1), ("texels", 1)):
            if getattr(self, name) < least:
                raise UserError(name, expected=f"at least {least}", found=getattr(self, name))
        if not self.lights or len(set(self.lights)) < len(self.lights):
            raise UserError("lights", expected="lights of different names", found=", ".join(self.lights))
        if self.orbit and self.orbit[0] != View(0, 0):
            raise UserError("orbit", expected="a first view from straight ahead", found=self.orbit[0])

    @property
    def capture(self) -> str:
        """The light of most pictures."""
        return self.lights[0]

    def recipe(self, digests: Sequence[str] = ()) -> str:
        """A hash of all that decides the bytes of the dataset; ``digests`` are those of a user's lights."""
        return hashlib.sha256(json.dumps([VERSION, asdict(self), *digests]).encode()).hexdigest()[:12]

    def takes(self) -> list[Take]:
        """Every picture to take, those of a pose after one another."""
        step = max(self.test // max(self.relit, 1), 1)
        relit = range(self.train, self.train + min(step * self.relit, self.test), step)
        taken = []
        for frame in range(self.train + self.test):
            truth = ("albedo",) if frame < self.train else SURFACE_LAYERS
            mirrored = (f"gt/highlights/{self.capture}",) if frame in relit else ()
            taken.append(Take(frame, self.capture, ("images", "fg_masks", *truth, *mirrored)))
            others = self.lights[1:] if frame in relit else ()
            taken += [
                Take(frame, light, (f"gt/relight/{light}", f"gt/highlights/{light}")) for light in others
            ]
        of_orbit = tuple(f"{ORBIT}/{layer}" for layer in ("images", "fg_masks"))
        return taken + [
            Take(pose, self.capture, of_orbit, view) for pose in range(len(POSES)) for view in self.orbit
        ]


def film_name(frame: int) -> str:
    """What the files of a frame of the film are called, without their suffix."""
    return f"{frame:05d}_00"


class Take(NamedTuple):
    """One picture to take.

    Attributes:
        pose: Which frame it shows, of an orbit which of its poses.
        light: One of the plan's lights.
        layers: Folders within the dataset into each of which a file of it goes.
        view: From where an orbit's camera looks; None is the camera of the film.
    """

    pose: int
    light: str
    layers: tuple[str, ...]
    view: View | None = None

    @property
    def file(self) -> str:
        """The name of its file in each of the folders."""
        return f"{film_name(self.pose) if self.view is None else view_name(self.pose, self.view)}.png"

    def __str__(self) -> str:
        return (
            f"frame {self.pose} under {self.light}" if self.view is None else view_name(self.pose, self.view)
        )

    def is_in(self, folder: Path) -> bool:
        """Whether a dataset has all its files."""
        return all((folder / layer / self.file).exists() for layer in self.layers)
