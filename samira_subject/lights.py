"""The lights of a dataset: skies of our own, and maps and lamps of a user's, each as one panorama."""

from __future__ import annotations

import hashlib
import json
import math
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from samira_subject.raycaster_sampling import SkyTables
from samira_subject.sky import SKIES, exposure_of, paint_sky
from samira_subject.studio import threads
from samira_warp.light import DirectionalLight, LightRig, RadianceMap
from samira_warp.light.equirect import cube_to_equirect

ROWS = 512
"""Rows of the panorama of a user's light: a lamp of half a degree is a pixel and a half high."""

ROWS_STEP = 64
"""What rows are a multiple of: irradiance is summed over whole blocks of pixels."""


LAMP = "lamp"
"""The light that is no sky: a small lamp in the dark, as shading shows a surface's smallest bends."""

BUILT_IN = (*SKIES, LAMP)
"""The lights that have names."""

LAMP_ROWS = 256
"""Rows of its panorama, of which it spans 9."""

_LAMP = LightRig((DirectionalLight((-0.72, 0.46, 0.52), (math.pi,) * 3, radius=3.0),))
"""From the subject's right and above, across the face. White that faces it is as bright as a display's white:
skin and its highlights are not clipped."""

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
            radiance: (H, 2 H, 3) float32, linear; None is the sky of that name, or the lamp.
            exposure: Factor on it; None brings it to the brightness of all others but
                the lamp, which is dimmer.
        """
        self.name = name
        with threads(1):
            self.radiance = built_in_radiance(name) if radiance is None else radiance
            if exposure is None:
                exposure = 1.0 if name == LAMP and radiance is None else exposure_of(self.radiance)
            self.exposure = exposure
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


@cache
def built_in_light(name: str) -> DatasetLight:
    """One of BUILT_IN, made once in a process: its tables take a third of a second."""
    return DatasetLight(name)


def built_in_radiance(name: str) -> Tensor:
    """(H, 2 H, 3) float32 panorama of one of SKIES, or of the lamp."""
    return _LAMP.to_panorama(LAMP_ROWS) if name == LAMP else paint_sky(SKIES[name])


def panorama_of(light: str | Path | None, rig: LightRig | None, *, rotate: float = 0.0) -> Tensor:
    """(H, 2 H, 3) float32 radiance of a sky or a map, of lamps, or of both, turned.

    What rays are drawn from is what the dataset's file has, so the turn is in the texels.

    Args:
        light: One of SKIES, the lamp, or a map, any that `RadianceMap` reads; None for lamps alone.
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
    if light in BUILT_IN:
        return built_in_radiance(str(light))
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
