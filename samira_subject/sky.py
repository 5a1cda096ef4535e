"""The skies that light the built-in subject: a gradient from ground to zenith, and softboxes before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from samira_warp.light.color import LUMINANCE
from samira_warp.light.equirect import equirect_directions, row_solid_angles

HEIGHT = 128
"""Rows of a panorama, which is twice as wide: a softbox's edge is some four texels."""

HORIZON = 0.35
"""Sine of the elevation over which the horizon's colour passes into that of the zenith or the ground."""

DISPLAYED = 0.8
"""What `exposure_of` makes of the light: a white card before it is a little below a display's white."""

Colour = tuple[float, float, float]
"""Linear red, green and blue."""


@dataclass(frozen=True)
class Softbox:
    """A rectangular lamp.

    Attributes:
        azimuth: Degrees of its middle, from straight before the face (+z) towards the subject's left (+x).
        elevation: Degrees of its middle above the horizon.
        width: Degrees that it spans along the horizon, below 180.
        height: Degrees that it spans across.
        radiance: Linear.
        feather: Share of the half width and half height over which its edges fade.
    """

    azimuth: float
    elevation: float
    width: float
    height: float
    radiance: Colour
    feather: float = 0.35


@dataclass(frozen=True)
class Sky:
    """A light all around.

    Attributes:
        zenith: Radiance straight above.
        horizon: Radiance at eye level.
        ground: Radiance straight below.
        softboxes: What stands before it.
    """

    zenith: Colour
    horizon: Colour
    ground: Colour
    softboxes: tuple[Softbox, ...]


CAPTURE = "studio"
"""The light of the subject's own pictures."""

SKIES = {
    # a warm key from the left above, a wide cool fill opposite, and a lamp behind that draws the outline
    "studio": Sky(
        zenith=(0.26, 0.28, 0.32),
        horizon=(0.22, 0.22, 0.23),
        ground=(0.16, 0.14, 0.125),
        softboxes=(
            Softbox(azimuth=42.0, elevation=32.0, width=50.0, height=54.0, radiance=(5.4, 4.95, 4.3)),
            Softbox(
                azimuth=-52.0,
                elevation=10.0,
                width=60.0,
                height=64.0,
                radiance=(0.95, 1.06, 1.26),
                feather=0.6,
            ),
            Softbox(azimuth=-146.0, elevation=26.0, width=34.0, height=60.0, radiance=(3.6, 4.0, 4.6)),
        ),
    ),
    # a tall window on the subject's right, and a room that sends little back
    "window": Sky(
        zenith=(0.14, 0.13, 0.12),
        horizon=(0.17, 0.155, 0.14),
        ground=(0.13, 0.10, 0.075),
        softboxes=(
            Softbox(
                azimuth=-80.0, elevation=12.0, width=46.0, height=62.0, radiance=(5.0, 5.9, 7.0), feather=0.15
            ),
            Softbox(
                azimuth=118.0,
                elevation=4.0,
                width=60.0,
                height=40.0,
                radiance=(0.34, 0.29, 0.24),
                feather=0.8,
            ),
        ),
    ),
    # a violet sky over dark ground, and what is left of the sun low on the subject's left
    "dusk": Sky(
        zenith=(0.10, 0.14, 0.34),
        horizon=(0.52, 0.33, 0.36),
        ground=(0.07, 0.055, 0.05),
        softboxes=(
            Softbox(
                azimuth=62.0, elevation=8.0, width=26.0, height=15.0, radiance=(16.0, 6.6, 2.3), feather=0.5
            ),
            Softbox(
                azimuth=62.0, elevation=6.0, width=110.0, height=26.0, radiance=(1.3, 0.62, 0.36), feather=0.9
            ),
        ),
    ),
    # two coloured lamps from the sides and a white one from high above, in the dark
    "stage": Sky(
        zenith=(0.05, 0.05, 0.06),
        horizon=(0.05, 0.045, 0.05),
        ground=(0.06, 0.05, 0.055),
        softboxes=(
            Softbox(azimuth=84.0, elevation=14.0, width=26.0, height=40.0, radiance=(6.4, 1.3, 2.6)),
            Softbox(azimuth=-84.0, elevation=14.0, width=26.0, height=40.0, radiance=(0.9, 3.0, 7.4)),
            Softbox(azimuth=8.0, elevation=58.0, width=26.0, height=26.0, radiance=(4.6, 4.4, 4.0)),
        ),
    ),
}
"""The lights by name; each in the units of its own, for `exposure_of` to bring to one brightness."""


def paint_sky(sky: Sky, *, height: int = HEIGHT) -> Tensor:
    """(height, 2 height, 3) float32 linear radiance of a sky.

    Its layout is that of `samira_warp.light.equirect` without a turn.
    """
    directions = equirect_directions(height).double()
    up = directions[..., 1:2]
    share = torch.sin(0.5 * math.pi * (up.abs() / HORIZON).clamp(max=1.0)) ** 2
    pole = torch.where(up > 0.0, _vector(sky.zenith), _vector(sky.ground))
    radiance = _vector(sky.horizon) + share * (pole - _vector(sky.horizon))
    for softbox in sky.softboxes:
        radiance = radiance + _coverage(softbox, directions)[..., None] * _vector(softbox.radiance)
    return radiance.float()


def exposure_of(radiance: Tensor) -> float:
    """The exposure of a light: 0.8 over its brightness, by luminance.

    That is 0.5 x its mean radiance + 0.5 x the irradiance on a surface that faces +z / pi.
    """
    brightness = radiance.double() @ torch.tensor(LUMINANCE, dtype=torch.float64)
    height, width = brightness.shape
    angles = row_solid_angles(height, width)[:, None]
    facing = equirect_directions(height)[..., 2].double().clamp(min=0.0)
    mean = (brightness * angles).sum() / (4.0 * math.pi)
    front = (brightness * facing * angles).sum() / math.pi
    return DISPLAYED / float(0.5 * mean + 0.5 * front)


def _coverage(softbox: Softbox, directions: Tensor) -> Tensor:
    """(H, W) how much of a softbox lies in each direction: 1 in its middle, falling to 0 at its edges."""
    azimuth, elevation = math.radians(softbox.azimuth), math.radians(softbox.elevation)
    middle = (
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
        math.cos(elevation) * math.cos(azimuth),
    )
    across = (math.cos(azimuth), 0.0, -math.sin(azimuth))
    upwards = (
        -math.sin(elevation) * math.sin(azimuth),
        math.cos(elevation),
        -math.sin(elevation) * math.cos(azimuth),
    )
    depth, x, y = (directions @ _vector(axis) for axis in (middle, across, upwards))
    ahead = depth.clamp(min=1e-6)
    coverage = (depth > 0.0).double()
    for offset, extent in ((x, softbox.width), (y, softbox.height)):
        inwards = 1.0 - (offset / ahead).abs() / math.tan(math.radians(0.5 * extent))
        coverage = coverage * _smooth_step(inwards / softbox.feather)
    return coverage


def _smooth_step(value: Tensor) -> Tensor:
    clipped = value.clamp(0.0, 1.0)
    return clipped * clipped * (3.0 - 2.0 * clipped)


def _vector(values: tuple[float, float, float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)
