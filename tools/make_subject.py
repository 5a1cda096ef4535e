"""Make a subject like the built-in one: another head, another performance, another light, or larger pictures.

usage: python tools/make_subject.py --seed N --out DIR [--resolution N] [LIGHT] [--relight NAME|FILE ...]
       python tools/make_subject.py --seed N --preview FILE.png [--frame N] [LIGHT]
LIGHT: [--light NAME|MAP] [--lights RIG.json] [--rotate DEGREES] [--exposure FACTOR]

Every light is distant, lamps too: they are seen from the head's centre. Rays find shadows against the head.
"""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from samira_subject.cast import build_cast
from samira_subject.lights import BUILT_IN, DatasetLight, panorama_of
from samira_subject.make import make_subject
from samira_subject.orbit import VIEWS
from samira_subject.performance import perform
from samira_subject.plan import SIZE, TEXELS, SubjectPlan
from samira_subject.raycaster import Effort
from samira_subject.sky import CAPTURE
from samira_subject.studio import Studio, developed
from samira_warp.io.alone import alone
from samira_warp.io.images import write_png
from samira_warp.light import LightRig
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

PREVIEW_EFFORT = Effort(samples=16, more=16, tolerance=0.02)
"""Rays of a picture that is looked at: an error of 2 % of the radiance is about one of 256 levels in skin's
display values."""

CAPTURE_NAME = "capture"
"""What a user's light is called in the dataset, and no other light of it."""

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
    orbit: bool = True
    """Film gt/orbit as well: two poses held, from all around."""
    hidden_motion: bool = False
    """Let the head move as well as its template has no shapes for, which no track says: gt/hidden_motion.npz
    does."""
    preview: Path | None = None
    """The .png file of one picture of the head alone."""
    preview_size: int = 1024
    """Width and height of that picture, pixels."""
    frame: int = 0
    """Which frame it shows; the first one is at rest."""
    light: str | None = None
    """The light of the pictures: a built-in one (studio, window, dusk, stage, lamp) or a map (.hdr, .exr);
    default studio, or none beside --lights."""
    lights: Path | None = None
    """Lamps, a .json file (docs/relighting.md): added to --light, or the only light."""
    rotate: float = 0.0
    """Degrees by which this light is turned about the vertical."""
    exposure: float | None = None
    """Factor on it; default brings it to the brightness of the others."""
    relight: tuple[str, ...] = ()
    """Lights of the relit test frames: built-in ones, maps, or .json files of lamps; default the other
    built-in ones."""


def main(config: SubjectConfig) -> None:
    """Make what was asked for, once all of it is known to be possible."""
    _check_numbers(config)
    _check_targets(config)
    lights = _read_lights(config)
    if config.preview is not None:
        _write_preview(config, config.preview, lights[0])
    if config.out is not None:
        _make_dataset(config, config.out, lights)


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
    if not math.isfinite(config.rotate):
        raise UserError("--rotate", expected="degrees", found=config.rotate)
    if config.exposure is not None and not 0.0 < config.exposure < math.inf:
        raise UserError("--exposure", expected="a factor above 0", found=config.exposure)
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


def _read_lights(config: SubjectConfig) -> list[DatasetLight]:
    """The light of the pictures, and, of a dataset, those of relit frames.

    Raises:
        UserError: One cannot be read or is black, or two would be called the same.
    """
    rig = None if config.lights is None else LightRig.load(config.lights)
    own = CAPTURE if config.light is None and rig is None else config.light
    is_built_in = own in BUILT_IN and rig is None and config.rotate == 0.0
    name = str(own) if is_built_in else CAPTURE_NAME
    others = config.relight or tuple(light for light in BUILT_IN if light != name)
    names = [name, *(what if what in BUILT_IN else Path(what).stem for what in others)]
    for other in names[1:]:
        if names.count(other) > 1 or other == CAPTURE_NAME:
            found = f"{other!r}, which the light of the pictures or another one is called"
            raise UserError("--relight", expected="lights whose names differ", found=found)
    lights = [_light(own, rig, name, rotate=config.rotate, exposure=config.exposure)]
    if config.out is not None:
        lights += [_other_light(what, other) for what, other in zip(others, names[1:], strict=True)]
    return lights


def _other_light(what: str, name: str) -> DatasetLight:
    """A light of relit frames."""
    is_rig = Path(what).suffix.lower() == ".json"
    return _light(None if is_rig else what, LightRig.load(what) if is_rig else None, name)


def _light(
    what: str | None,
    rig: LightRig | None,
    name: str,
    *,
    rotate: float = 0.0,
    exposure: float | None = None,
) -> DatasetLight:
    """A built-in light or a map, with lamps or without; None is lamps alone.

    Raises:
        UserError: It cannot be read, or is black.
    """
    if what == name and name in BUILT_IN:
        return DatasetLight(name, exposure=exposure)
    radiance = panorama_of(what, rig, rotate=rotate)
    if not bool(radiance.any()):
        raise UserError(what or "the lamps", expected="some light", found="none")
    return DatasetLight(name, radiance, exposure)


def _make_dataset(config: SubjectConfig, out: Path, lights: list[DatasetLight]) -> None:
    """The dataset, by this process alone."""
    texels = _texels(config.resolution)
    plan = SubjectPlan(
        config.seed,
        config.train,
        config.test,
        config.relit,
        config.resolution,
        texels,
        lights=tuple(light.name for light in lights),
        hidden=config.hidden_motion,
        orbit=VIEWS if config.orbit else (),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    with alone(out, what="a subject"):
        _check_targets(config)  # another process may have made it
        make_subject(
            out, plan, partial(build_cast, config.seed, texels=texels, hidden=config.hidden_motion), lights
        )


def _write_preview(config: SubjectConfig, path: Path, light: DatasetLight) -> None:
    """One picture of one frame under one light."""
    cast = build_cast(config.seed, texels=_texels(config.preview_size), hidden=config.hidden_motion)
    performance = perform(
        cast.template.expression_names,
        train=config.train,
        test=config.test,
        seed=config.seed,
        quick_tilts=config.hidden_motion,
    )
    studio = Studio(cast, size=config.preview_size, effort=PREVIEW_EFFORT)
    posed = studio.pose(performance.frame(config.frame))
    picture = studio.take(posed, light.tables, seed=config.seed)
    write_png(path, developed(picture))


def _texels(size: int) -> int:
    """Width and height of the maps for pictures of a size: as many a pixel as the built-in subject has.

    At most at twice its width, though: painting takes half a minute and more than 2 GB there, and four times
    that at the next step.
    """
    return TEXELS * min(max(size // SIZE, 1), 2)


if __name__ == "__main__":
    sys.exit(run(main, SubjectConfig, program="python tools/make_subject.py"))
