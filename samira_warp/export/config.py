"""Options of the export verb."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure, check_exposure

Format = Literal["ply"]
"""Kinds of files, by the suffix that they have; `samira_warp.export.formats` writes them."""


@dataclass(frozen=True)
class ExportConfig:
    """Write one frame of an avatar as a file that splat viewers open.

    Gaussians are in world space, after binding and residual. Without --env and --lights their colour is
    their albedo; with them, what the frame's camera sees of each under that light, highlights and all.
    """

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """The file to write, whose name ends in the format's suffix."""
    format: Format = "ply"
    """ply: 3D Gaussian splatting's columns, as its viewers read them."""
    frame: int = 0
    """Which of the avatar's own frames, test frames first."""
    env: tuple[Path, ...] = ()
    """Light: a map (.hdr, .exr; panorama or cube cross), a diffuse and a specular map, or an avatar's folder,
    for the light that was learned with it."""
    lights: Path | None = None
    """Lamps, a .json file (docs/relighting.md): added to --env, or the only light."""
    ldr: bool = False
    """Take 8-bit pictures as environment maps, too."""
    rotate: float = 0.0
    """Degrees by which the light is turned about the vertical."""
    exposure: Exposure = 1.0
    """Factor on the light; auto makes its irradiance 1, averaged over all directions."""

    def check(self) -> None:
        """Raise UserError unless the options can be used and the file written."""
        check_exposure(self.exposure, name="--exposure")
        if not math.isfinite(self.rotate):
            raise UserError("--rotate", expected="degrees", found=self.rotate)
        for name, given in (("rotate", self.rotate != 0.0), ("exposure", self.exposure != 1.0)):
            if given and not (self.env or self.lights):
                raise UserError(f"--{name}", expected="--env or --lights with it, a light", found="none")
        suffix = f".{self.format}"
        if self.out.suffix != suffix:
            found = self.out.suffix or "no suffix"
            raise UserError(self.out, expected=f"a file name ending in {suffix}", found=found)
        if not self.out.parent.is_dir():
            raise UserError(self.out.parent, expected="an existing folder", found="no such folder")
