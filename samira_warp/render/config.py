"""Options of the render verb."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction

from samira_warp.stage.layer_names import Layer
from samira_warp.support.device_names import DeviceName
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure, check_exposure
from samira_warp.support.image_size import check_side
from samira_warp.support.tone_names import ToneMap

WIDEST_VIEW = 150.0
"""Degrees; beyond, a Gaussian's footprint at the picture's edge is no ellipse that splatting knows."""


@dataclass(frozen=True)
class RenderConfig:
    """Render an avatar: re-animated by a sequence, relit by a map or by lamps, its materials changed.

    Without --env and --lights the light is the one that was learned with the avatar. A folder of maps makes
    a contact sheet: one frame under every map.
    """

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """Output folder; images go to OUT/LAYER/NAME.png."""
    data: Path | None = None
    """Sequence that drives the avatar; default its own frames. Another person's sequence is
    cross-reenactment."""
    drive: str | None = None
    """In place of --data, what drives the avatar: a film, a camera (its number or device), a recording of
    Live Link Face (.csv), or udp://HOST:PORT for phones. A camera and a port are recorded until Ctrl-C."""
    neutral: int | None = None
    """Frame of --drive, counted from 0, whose face is neutral; default the first ones of a film or a camera,
    zeros for the others."""
    smoothing: float = 1.0
    """Of --drive, against jitter: 0 is none, 2 twice as much."""
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
    lights: Path | None = None
    """Lamps, a .json file (docs/relighting.md): added to --env, or the only light."""
    ldr: bool = False
    """Take 8-bit pictures as environment maps, too."""
    rotate: float = 0.0
    """Degrees by which the light is turned about the vertical."""
    exposure: Exposure | None = None
    """Factor on the light; auto makes its irradiance 1, averaged over all directions. Default auto for a map
    or lamps, whose brightness is anybody's, 1 for a learned light."""
    tone_map: Literal["auto"] | ToneMap = "auto"
    """filmic bends what is brighter than a display's white below it, none clips it; auto is filmic for a map
    or lamps, and none for a learned light, whose pictures are compared with what was filmed."""
    turntable: float | None = None
    """Seconds in which the light goes round once, round one held frame (--frames N) or the sequence; writes
    videos."""
    camera: str | None = None
    """YAW,PITCH,DISTANCE: a camera of one's own, about the middle of the first frame's head and in its axes.
    Degrees of yaw, 0 before the face, positive towards the head's left; degrees of pitch, positive above;
    metres, default the training camera's. The frames' heads move before it."""
    fov: float | None = None
    """Degrees that the longer side of the picture spans; default the training camera's, or the frames' own
    without --camera."""
    orbit: float | None = None
    """Seconds in which the camera goes round the head once, from --camera or from before the face, about one
    held frame (--frames N) or the sequence; writes videos."""
    shadows: Literal["on", "off"] = "on"
    """Let the head block the light. An avatar that learned its light without shadows casts none under it."""
    background: str = "white"
    """white, black, a colour (red,green,blue from 0 to 1, or #rrggbb), env (the environment behind the head),
    an image file, or transparent: PNG with straight alpha."""
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
    """Where to compute: cpu, cuda, cuda:N, or auto, a GPU where there is one."""

    def check(self) -> None:
        """Raise UserError unless every number can be used."""
        if self.exposure is not None:
            check_exposure(self.exposure, name="--exposure")
        if self.resolution is not None:
            check_side("--resolution", self.resolution)
        check_drive(self.drive, data=self.data, split=self.split, neutral=self.neutral)
        if self.drive is not None and self.neutral_frame is not None:
            raise UserError("--neutral-frame", expected="--neutral beside --drive", found="--neutral-frame")
        ranges = {
            "expression-gain": (math.isfinite(self.expression_gain), "a number"),
            "smoothing": (0.0 <= self.smoothing < math.inf, "0 or more"),
            "rotate": (math.isfinite(self.rotate), "degrees"),
            "turntable": (
                self.turntable is None or 0.0 < self.turntable < math.inf,
                "a positive number of seconds",
            ),
            "orbit": (self.orbit is None or 0.0 < self.orbit < math.inf, "a positive number of seconds"),
            "fov": (
                self.fov is None or 1.0 <= self.fov <= WIDEST_VIEW,
                f"degrees from 1 to {WIDEST_VIEW:g}",
            ),
            "fps": (0.0 < self.fps < math.inf, "a positive number of frames"),
        }
        for name, (holds, expected) in ranges.items():
            if not holds:
                raise UserError(f"--{name}", expected=expected, found=getattr(self, name.replace("-", "_")))

    @property
    def films(self) -> str | None:
        """The first option given that writes videos, None where there is none."""
        asked = {
            "--turntable": self.turntable is not None,
            "--orbit": self.orbit is not None,
            "--video": self.video,
        }
        return next((name for name, given in asked.items() if given), None)


def check_drive(drive: str | None, *, data: Path | None, split: str | None, neutral: int | None) -> None:
    """Raise UserError unless the options of what drives an avatar go together."""
    if drive is not None and data is not None:
        raise UserError("--drive", expected="it or --data, one of them", found="both")
    if drive is not None and split is not None:
        raise UserError("--split", expected="--data with it", found="--drive")
    if neutral is not None and drive is None:
        raise UserError("--neutral", expected="--drive with it", found="none")
    if neutral is not None and neutral < 0:
        raise UserError("--neutral", expected="a frame, counted from 0", found=neutral)
