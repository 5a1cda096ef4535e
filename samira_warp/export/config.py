"""Options of the export verb."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from samira_warp.export.formats import FORMATS, ExportFormat, Format, format_of
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import Exposure, check_exposure
from samira_warp.support.tone_names import ToneMap

SPZ_VERSION = 2
"""The version of a .spz unless another is asked for."""

SPZ_WITH_ZSTD = 4
"""The version whose compression Python has no module for."""


@dataclass(frozen=True)
class ExportConfig:
    """Write an avatar for other programs (docs/exports.md).

    Splats are in world space, after binding and residual, and have colours but no light: those that the
    frame's camera sees under the learned light, under --env and --lights, or their --albedo.
    """

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    out: Path
    """The file to write, or the folder."""
    format: Format | None = None
    """What to write; default what only one format's files are called as --out is."""
    frame: int | None = None
    """Which of the avatar's own frames, test frames first; default the first."""
    frames: str | None = None
    """For a sequence, which of the frames of --split, A:B:STEP as Python slices them; default all."""
    split: Literal["train", "test"] | None = None
    """For a sequence, which of the avatar's own frames; default the test frames."""
    spz_version: Literal[2, 3, 4] | None = None
    """Of a .spz: 4 is the newest; 2, the default, is what most programs open, and no worse
    (docs/exports.md)."""
    albedo: bool = False
    """The colour of the materials alone, under no light."""
    env: tuple[Path, ...] = ()
    """Light: a map (.hdr, .exr; panorama or cube cross), a diffuse and a specular map, or an avatar's folder,
    for the light that was learned with it; default the avatar's own."""
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
    """filmic bends what is brighter than a display's white below it, none clips it where a format does; auto
    is filmic for a map or lamps, and none for a learned light."""

    texture_size: int | None = None
    """For a format with textures, texels along their sides; default 1024."""

    @property
    def kind(self) -> ExportFormat:
        """The format that is asked for, or meant.

        Raises:
            UserError: Neither is clear.
        """
        return format_of(self.format, self.out)

    def check(self) -> None:
        """Raise UserError unless the options can be used, and the format's library and a place are there."""
        kind = self.kind
        self._check_light(kind)
        kind.check_target(self.out)
        for option, given in (("--frames", self.frames), ("--split", self.split)):
            if given is not None and kind.frames == "one":
                found = f"--format {kind.name}, which holds one frame (--frame N)"
                raise UserError(option, expected="a format of many frames", found=found)
        if self.frame is not None and (kind.frames == "many" or self.frames or self.split):
            raise UserError("--frame", expected="one frame's export", found="a sequence (--frames N for one)")
        if self.texture_size is not None:
            self._check_texture_size(self.texture_size, kind)
        if self.spz_version is not None and kind.name != "spz":
            raise UserError("--spz-version", expected="--format spz", found=f"--format {kind.name}")
        if kind.name != "spz" or self.spz_version == SPZ_WITH_ZSTD:
            kind.check_installed()

    def _check_texture_size(self, size: int, kind: ExportFormat) -> None:
        if not kind.textures:
            raise UserError(
                "--texture-size", expected="a format with textures", found=f"--format {kind.name}"
            )
        if not 64 <= size <= 4096:
            raise UserError("--texture-size", expected="64 to 4096", found=size)

    def _check_light(self, kind: ExportFormat) -> None:
        if self.exposure is not None:
            check_exposure(self.exposure, name="--exposure")
        if not math.isfinite(self.rotate):
            raise UserError("--rotate", expected="degrees", found=self.rotate)
        needs_light = {
            "--env": bool(self.env),
            "--lights": self.lights is not None,
            "--rotate": self.rotate != 0.0,
            "--exposure": self.exposure is not None,
            "--tone-map": self.tone_map != "auto",
        }
        for option, given in needs_light.items():
            if given and self.albedo:
                raise UserError(option, expected="a light", found="--albedo, which is the colour under none")
            if given and not kind.lit:
                found = f"--format {kind.name}, which holds materials"
                raise UserError(option, expected="a format of colours under a light", found=found)


__all__ = ["FORMATS", "ExportConfig", "Format"]
