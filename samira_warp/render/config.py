"""Options of the render verb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from samira_warp.devices import DeviceName
from samira_warp.errors import UserError
from samira_warp.render.layers import Layer


@dataclass(frozen=True)
class RenderConfig:
    """Render an avatar: re-animated by any tracked sequence, relit under any environment map."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """Output folder; images go to OUT/LAYER/NAME.png."""
    data: Path | None = None
    """Sequence that drives the avatar; default its own frames. Another person's sequence is cross-reenactment."""
    split: str | None = None
    """Frames of the sequence: train or test, a fraction, or last:N; default the test part of the split that the avatar was trained with."""
    frames: str | None = None
    """Of those frames, A:B:STEP as Python slices them."""
    env: Path | None = None
    """Environment map (.hdr or .exr, equirectangular) to relight under; default the learned capture light."""
    rotate: float = 0.0
    """Degrees by which the environment map is turned about the vertical."""
    exposure: float = 1.0
    """Factor on the light."""
    background: str = "white"
    """white, black, env (the environment behind the head) or an image file."""
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
        raise UserError("--frames", expected="A:B:STEP, whole numbers, any of which may be left out", found=repr(text)) from None
    if len(numbers) == 1:
        first = numbers[0]
        if first is None:
            raise UserError("--frames", expected="A:B:STEP", found=repr(text))
        return slice(first, first + 1 or None)
    return slice(*numbers)
