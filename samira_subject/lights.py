"""The lights of a dataset: skies of our own, and maps and lamps of a user's, each as one panorama."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path

import torch
from torch import Tensor

from samira_subject.raycaster_sampling import SkyTables
from samira_subject.sky import SKIES, exposure_of, paint_sky
from samira_subject.studio import threads
from samira_warp.light import LightRig, RadianceMap
from samira_warp.light.equirect import cube_to_equirect

ROWS = 512
"""Rows of the panorama of a user's light: a lamp of half a degree is a pixel and a half high."""

ROWS_STEP = 64
"""What rows are a multiple of: irradiance is summed over whole blocks of pixels."""


EVENLY = 0.5
"""Share of the draws that a user's light is not to keep for its brightest lamp, which may be a sun."""


class DatasetLight:
    """A light of the dataset.

    Attributes:
        name: What its files are called.
        radiance: (H, 2 H, 3) float32 panorama, as its file has it.
        exposure: Factor on it.
        tables: The light as the rays find it, exposed.
    """

    def __init__(self, name: str, radiance: Tensor | None = None, exposure: float | None = None) -> None:
        """Take a panorama as a light.

        Args:
            name: What it is called.
            radiance: (H, 2 H, 3) float32, linear; None is the sky of that name.
            exposure: Factor on it; None brings it to the brightness of all others.
        """
        self.name = name
        with threads(1):
            self.radiance = paint_sky(SKIES[name]) if radiance is None else radiance
            self.exposure = exposure_of(self.radiance) if exposure is None else exposure
            self.tables = SkyTables.build(
                self.radiance * self.exposure, evenly=0.0 if radiance is None else EVENLY
            )

    @property
    def file(self) -> str:
        """Where the panorama lies within the dataset."""
        return f"lights/{self.name}.exr"

    @property
    def digest(self) -> str:
        """A hash of its name and of every number of it."""
        content = self.name.encode() + self.radiance.numpy().tobytes() + repr(self.exposure).encode()
        return hashlib.sha256(content).hexdigest()

    def description(self) -> str:
        """What says how pictures under it are lit."""
        return json.dumps({"file": self.file, "azimuth_degrees": 0.0, "exposure": self.exposure}, indent=1)


def panorama_of(light: str | Path | None, rig: LightRig | None, *, rotate: float = 0.0) -> Tensor:
    """(H, 2 H, 3) float32 radiance of a sky or a map, of lamps, or of both, turned.

    What rays are drawn from is what the dataset's file has, so the turn is in the texels.

    Args:
        light: One of SKIES, or a map, any that `RadianceMap` reads; None for lamps alone.
        rig: Lamps, as the head's centre sees them; None for none.
        rotate: Degrees by which the whole is turned.

    Raises:
        UserError: The map cannot be used.
    """
    with threads(1):
        radiance = _panorama(light)
        rows = ROWS if rig is not None else min(math.ceil(len(radiance) / ROWS_STEP) * ROWS_STEP, ROWS)
        radiance = resampled(radiance, rows=rows)
        if rig is not None:
            radiance = radiance + rig.to_panorama(rows)
        return resampled(radiance, rows=rows, rotate=rotate).contiguous()


def _panorama(light: str | Path | None) -> Tensor:
    """(H, 2 H, 3) float32, of any size: black for None."""
    if light is None:
        return torch.zeros(ROWS, 2 * ROWS, 3)
    if light in SKIES:
        return paint_sky(SKIES[str(light)])
    radiance = RadianceMap.read(light)
    if radiance.face_size is None:
        return radiance.texels
    return cube_to_equirect(radiance.texels, height=2 * radiance.face_size)


def resampled(radiance: Tensor, *, rows: int, rotate: float = 0.0) -> Tensor:
    """A panorama (H, W, 3) at (rows, 2 rows, 3), turned by so many degrees; each pixel a mean by solid angle.

    Pixels are taken as patches of one radiance each, and what two of them share is exact: light is neither
    lost nor won.
    """
    height, width = radiance.shape[:2]
    if (height, rotate % 360.0) == (rows, 0.0):
        return radiance
    # rows by the cosine of the polar angle, whose steps are solid angles
    old, new = (
        -torch.cos(torch.linspace(0.0, math.pi, count + 1, dtype=torch.float64)) for count in (height, rows)
    )
    down = _shares(new, old)
    # a turned light is looked up so much farther on, in a panorama that goes on at its end
    old = torch.arange(-width, 2 * width + 1, dtype=torch.float64) / width
    new = torch.linspace(0.0, 1.0, 2 * rows + 1, dtype=torch.float64) + (rotate / 360.0) % 1.0
    across = _shares(new, old).view(2 * rows, 3, width).sum(dim=1)
    return torch.einsum("rh,hwc,kw->rkc", down.float(), radiance, across.float())


def _shares(new: Tensor, old: Tensor) -> Tensor:
    """(N, O) float64 share of each new interval that lies in each old one, from their edges in order."""
    common = torch.minimum(new[1:, None], old[1:]) - torch.maximum(new[:-1, None], old[:-1])
    return common.clamp(min=0.0) / (new[1:] - new[:-1])[:, None]
