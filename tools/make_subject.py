"""Make a subject like the built-in one: another head, another performance, or larger pictures.

usage: python tools/make_subject.py --seed N --out DIR [--resolution N]
       python tools/make_subject.py --seed N --preview FILE.png [--frame N] [--light NAME]
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from samira_subject.cast import build_cast
from samira_subject.make import DatasetLight, make_subject
from samira_subject.performance import perform
from samira_subject.plan import SIZE, TEXELS, SubjectPlan
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE, SKIES
from samira_subject.studio import Studio, developed
from samira_warp.io.alone import alone
from samira_warp.io.images import write_png
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

PREVIEW_EFFORT = Effort(samples=16, more=16, tolerance=0.02)
"""Rays of a picture that is looked at: an error of 2 % of the radiance is about one of 256 levels in skin's
display values."""

LARGEST_SEED = 2**31 - 1
"""What the ray caster's kernels take: an int32."""


@dataclass(frozen=True)
class SubjectConfig:
    """Make a subject like the built-in one, or one large picture of it."""

    seed: int = 0
    """Whose head it is, and what it does; 0 to 2^31 - 1."""
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
    """Make what was asked for, once all of it is known to be possible."""
    _check_numbers(config)
    _check_targets(config)
    if config.preview is not None:
        _write_preview(config, config.preview)
    if config.out is not None:
        _make_dataset(config, config.out)


def _check_numbers(config: SubjectConfig) -> None:
    for name, least in (
        ("seed", 0),
        ("resolution", 1),
        ("train", 1),
        ("test", 1),
        ("relit", 0),
        ("preview_size", 1),
    ):
        if getattr(config, name) < least:
            raise UserError(
                f"--{name.replace('_', '-')}", expected=f"at least {least}", found=getattr(config, name)
            )
    if config.seed > LARGEST_SEED:
        raise UserError("--seed", expected=f"at most {LARGEST_SEED}", found=config.seed)
    if config.light not in SKIES:
        raise UserError("--light", expected=f"one of {', '.join(SKIES)}", found=config.light)
    if not 0 <= config.frame < config.train + config.test:
        raise UserError("--frame", expected=f"0 to {config.train + config.test - 1}", found=config.frame)


def _check_targets(config: SubjectConfig) -> None:
    if config.out is None and config.preview is None:
        raise UserError("--out", expected="a folder to make, or --preview FILE.png", found="neither")
    if config.out is not None and os.path.lexists(config.out):
        raise UserError(
            config.out, expected="a new folder", found="one that exists" if config.out.is_dir() else "a file"
        )
    if config.preview is not None:
        if config.preview.suffix.lower() != ".png" or config.preview.is_dir():
            found = "a folder" if config.preview.is_dir() else f"{config.preview.suffix!r}"
            raise UserError(config.preview, expected="the name of a .png file", found=found)
        if not config.preview.parent.is_dir():
            raise UserError(config.preview.parent, expected="a folder for the picture", found="none")


def _make_dataset(config: SubjectConfig, out: Path) -> None:
    """The dataset, by this process alone."""
    texels = _texels(config.resolution)
    plan = SubjectPlan(config.seed, config.train, config.test, config.relit, config.resolution, texels)
    out.parent.mkdir(parents=True, exist_ok=True)
    with alone(out, what="a subject"):
        _check_targets(config)  # another process may have made it
        make_subject(out, plan, partial(build_cast, config.seed, texels=texels))


def _write_preview(config: SubjectConfig, path: Path) -> None:
    """One picture of one frame under one light."""
    cast = build_cast(config.seed, texels=_texels(config.preview_size))
    performance = perform(
        cast.template.expression_names, train=config.train, test=config.test, seed=config.seed
    )
    studio = Studio(cast, size=config.preview_size, effort=PREVIEW_EFFORT)
    picture = studio.take(
        studio.pose(performance.frame(config.frame)), DatasetLight(config.light).tables, seed=config.seed
    )
    write_png(path, developed(picture))


def _texels(size: int) -> int:
    """Width and height of the maps for pictures of a size: as many a pixel as the built-in subject has.

    At most at twice its width, though: painting takes half a minute and more than 2 GB there, and four times
    that at the next step.
    """
    return TEXELS * min(max(size // SIZE, 1), 2)


if __name__ == "__main__":
    sys.exit(run(main, SubjectConfig, program="python tools/make_subject.py"))
