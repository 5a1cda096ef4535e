"""Options of the render verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction

from samira_warp.avatar import MaterialEdit
from samira_warp.light.environment import Exposure
from samira_warp.render.layers import Layer
from samira_warp.support.devices import DeviceName
from samira_warp.support.errors import UserError


@dataclass(frozen=True)
class RenderConfig:
    """Render an avatar: re-animated by any tracked sequence, relit under any environment map, its materials
    changed.

    Without --env the light is the one that was learned with the avatar. A folder of maps makes a contact
    sheet: one frame under every map.
    """

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """Output folder; images go to OUT/LAYER/NAME.png."""
    data: Path | None = None
    """Sequence that drives the avatar; default its own frames. Another person's sequence is
    cross-reenactment."""
    split: str | None = None
    """Frames of the sequence: train or test, a fraction, or last:N; default the test part of the split that
    the avatar was trained with."""
    frames: str | None = None
    """Of those frames, A:B:STEP as Python slices them."""
    neutral_frame: int | None = None
    """Frame of --data, counted from 0 over all of them, whose face is neutral; default a face without
    expression."""
    expression_gain: float = 1.0
    """Factor on the expression, relative to neutral."""
    clamp: bool = True
    """Hold another person's pose to what was seen in training."""
    env: tuple[Path, ...] = ()
    """Light: a map (.hdr, .exr; panorama or cube cross), a diffuse and a specular map, an avatar's folder, or
    a folder of maps."""
    ldr: bool = False
    """Take 8-bit pictures as environment maps, too."""
    rotate: float = 0.0
    """Degrees by which the light is turned about the vertical."""
    exposure: Exposure = 1.0
    """Factor on the light; auto makes its irradiance 1, averaged over all directions."""
    turntable: float | None = None
    """Seconds in which the light goes round once, round one held frame (--frames N) or the sequence; writes
    videos."""
    background: str = "white"
    """white, black, env (the environment behind the head) or an image file."""
    roughness: str | None = None
    """Change the materials' roughness: x0.5 multiplies it, 0.3 sets it."""
    specular: str | None = None
    """Change their reflectance at normal incidence: x2 multiplies it, 0.04 sets it."""
    albedo: str | None = None
    """Change their albedo: x1.2 multiplies it, 1.3,0.9,0.9 its red, green and blue; #c08060 paints."""
    region: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Where: forehead, left_eye, right_eye, nose, lips, mouth, cheeks, ears, scalp, neck; repeat it, or use
    commas; default everywhere."""
    layers: tuple[Layer, ...] = ("image",)
    """What to write of each frame."""
    resolution: int | None = None
    """Longer side of the images, pixels; default the size that the avatar was trained at."""
    video: bool = False
    """Also write OUT/LAYER.mp4."""
    fps: float = 25.0
    """Frames per second of the video."""
    device: DeviceName = "auto"
    """Where to compute."""


def parse_frames(text: str | None) -> slice:
    """Read A:B:STEP, any part of which may be left out.

    Raises:
        UserError: It is not of that form.
    """
    if text is None:
        return slice(None)
    parts = text.split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
        if len(numbers) > 3 or (len(numbers) == 3 and numbers[2] == 0):
            raise ValueError
    except ValueError:
        raise UserError(
            "--frames", expected="A:B:STEP, whole numbers, any of which may be left out", found=repr(text)
        ) from None
    if len(numbers) == 1:
        first = numbers[0]
        if first is None:
            raise UserError("--frames", expected="A:B:STEP", found=repr(text))
        return slice(first, first + 1 or None)
    return slice(*numbers)


def material_edits(config: RenderConfig) -> tuple[MaterialEdit, ...]:
    """The edit that the options ask for, or none.

    Raises:
        UserError: An option is not of its form, or regions are named but nothing to change in them.
    """
    regions = tuple(name for text in config.region for name in text.split(","))
    edit = MaterialEdit(config.roughness, config.specular, config.albedo, regions)
    if not edit.changes() and regions:
        raise UserError(
            "--region", expected="--roughness, --specular or --albedo with it", found="none of them"
        )
    return (edit,) if edit.changes() else ()
