"""Make a subject like the built-in one: another head, another performance, or larger pictures.

usage: python tools/make_subject.py --seed N --out DIR [--resolution N]
       python tools/make_subject.py --seed N --preview FILE.png [--frame N] [--light NAME]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from samira_warp.cli import run
from samira_warp.errors import UserError
from samira_warp.images import write_png
from samira_warp.subject.cache import build_cast
from samira_warp.subject.make import SIZE, TEXELS, Light, SubjectPlan, make_subject
from samira_warp.subject.performance import perform
from samira_warp.subject.raycaster import Effort
from samira_warp.subject.sky import CAPTURE, SKIES
from samira_warp.subject.studio import Studio, developed

PREVIEW_EFFORT = Effort(samples=16, more=16, tolerance=0.02)


@dataclass(frozen=True)
class SubjectConfig:
    """Make a subject like the built-in one, or one large picture of it."""

    seed: int = 0
    """Whose head it is, and what it does."""
    out: Path | None = None
    """Folder of the dataset to make."""
    resolution: int = SIZE
    """Width and height of the dataset's pictures, pixels."""
    train: int = 160
    """Frames to train on."""
    test: int = 40
    """Frames to test on."""
    relit: int = 10
    """How many of those are taken under each of the other lights as well."""
    preview: Path | None = None
    """The .png file of one picture of the head alone."""
    preview_size: int = 1024
    """Width and height of that picture, pixels."""
    frame: int = 0
    """Which frame it shows; the first one is at rest."""
    light: str = CAPTURE
    """Which light it is taken under."""


def main(config: SubjectConfig) -> None:
    """Make what was asked for."""
    if config.out is None and config.preview is None:
        raise UserError("--out", expected="a folder to make, or --preview FILE.png", found="neither")
    for name, least in (("seed", 0), ("resolution", 1), ("train", 1), ("test", 1), ("relit", 0), ("preview_size", 1)):
        if getattr(config, name) < least:
            raise UserError(f"--{name.replace('_', '-')}", expected=f"at least {least}", found=getattr(config, name))
    if config.preview is not None:
        _write_preview(config)
    if config.out is not None:
        if config.out.exists():
            raise UserError(config.out, expected="a new folder", found="one that exists")
        texels = _texels(config.resolution)
        plan = SubjectPlan(config.seed, config.train, config.test, min(config.relit, config.test), config.resolution, texels)
        make_subject(config.out, plan, build_cast(config.seed, texels=texels))


def _write_preview(config: SubjectConfig) -> None:
    """One picture of one frame under one light."""
    if config.light not in SKIES:
        raise UserError("--light", expected=f"one of {', '.join(SKIES)}", found=config.light)
    if not 0 <= config.frame < config.train + config.test:
        raise UserError("--frame", expected=f"0 to {config.train + config.test - 1}", found=config.frame)
    cast = build_cast(config.seed, texels=_texels(config.preview_size))
    performance = perform(cast.template.expression_names, train=config.train, test=config.test, seed=config.seed)
    studio = Studio(cast, size=config.preview_size, effort=PREVIEW_EFFORT)
    picture = studio.take(studio.pose(performance.frame(config.frame)), Light(config.light).tables, seed=config.seed)
    write_png(config.preview, developed(picture))


def _texels(size: int) -> int:
    """Width and height of the maps for pictures of a size."""
    return TEXELS * min(max(size // SIZE, 1), 2)


if __name__ == "__main__":
    sys.exit(run(main, SubjectConfig, program="python tools/make_subject.py"))
