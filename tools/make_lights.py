"""Paint the small lights that come with the package: the built-in subject's skies at one brightness.

usage: python tools/make_lights.py [--out samira_warp/assets/lights]

Each becomes a panorama in Radiance's .hdr format. A softbox's edge is a few of its pixels wide, and nothing
in it is smaller, so that 128 x 64 of them show all there is.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO
import torch

from samira_subject.sky import SKIES, paint_sky
from samira_warp.light.color import LUMINANCE
from samira_warp.light.equirect import row_solid_angles
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

HEIGHT = 64
"""Rows of a panorama, which is twice as wide: two to five kilobytes a file."""


@dataclass(frozen=True)
class LightsConfig:
    """Paint the small lights that come with the package."""

    out: Path = Path("samira_warp/assets/lights")
    """Existing folder to write NAME.hdr to."""


def main(config: LightsConfig) -> None:
    """Paint every sky and write it."""
    if not config.out.is_dir():
        raise UserError(config.out, expected="an existing folder", found="none")
    for name, sky in SKIES.items():
        _write_hdr(config.out / f"{name}.hdr", exposed(paint_sky(sky, height=HEIGHT)).numpy())


def exposed(radiance: torch.Tensor) -> torch.Tensor:
    """A panorama (H, 2 H, 3) at the exposure ``auto``: the luminance of its mean radiance is 1."""
    height, width, _ = radiance.shape
    brightness = radiance.double() @ radiance.new_tensor(LUMINANCE, dtype=torch.float64)
    mean = (brightness * row_solid_angles(height, width)[:, None]).sum() / (4.0 * math.pi)
    return radiance / float(mean)


def _write_hdr(path: Path, pixels: np.ndarray) -> None:
    picture = OpenImageIO.ImageBuf(np.ascontiguousarray(pixels))
    if not picture.write(str(path)):
        raise OSError(f"{path}: cannot be written: {picture.geterror()}")


if __name__ == "__main__":
    sys.exit(run(main, LightsConfig, program="python tools/make_lights.py"))
