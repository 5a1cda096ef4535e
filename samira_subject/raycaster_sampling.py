"""Numbers and directions that a ray caster draws: scrambled Sobol points, and the sky by its brightness."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.light.color import LUMINANCE
from samira_warp.light.equirect import equirect_directions, row_solid_angles, wrap_equirect

PI = wp.constant(math.pi)

_HASH_0 = wp.constant(wp.uint32(0x6C50B47C))
_HASH_1 = wp.constant(wp.uint32(0xB82F1E52))
_HASH_2 = wp.constant(wp.uint32(0xC7AFE638))
_HASH_3 = wp.constant(wp.uint32(0x8D22F6E6))
"""Multipliers of `_permute`, as published; even, so that a bit depends on lower ones alone."""

CANDIDATES = wp.constant(4)
"""Directions that `sample_lit_sky` chooses from: a shadow ray costs as much as some ten of them."""

IRRADIANCE_ROWS = 64
"""Rows of the table of irradiance: a cosine is linear within a texel to 3e-4."""

FLOOR = 1e-2
"""Share of the mean brightness that is added to every texel's chance, so that no direction is without."""


class SkyTables(NamedTuple):
    """A panorama and the chances of drawing its texels, piecewise constant in direction.

    Rows are equal steps of the polar angle.

    Attributes:
        radiance: (H, W, 3) float32, linear.
        rows: (H + 1,) float32 cumulated chances of the rows, from 0 to 1.
        columns: (H, W + 1) float32 cumulated chances of a row's texels, from 0 to 1.
        density: (H, W) float32 chance per steradian of a direction within the texel.
        irradiance: (66, 130, 3) float32 irradiance of surfaces by the direction that they face, a panorama
            with a border of one texel.
    """

    radiance: Tensor
    rows: Tensor
    columns: Tensor
    density: Tensor
    irradiance: Tensor

    @classmethod
    def build(cls, radiance: Tensor, *, evenly: float = 0.0) -> SkyTables:
        """The tables of a (H, W, 3) float32 panorama, on its device.

        Args:
            radiance: The panorama.
            evenly: Share of the draws that go by brightness only up to its mean: what a small lamp does not
                light is lit by the rest of the sky, to which next to no draw would go.
        """
        height, width = radiance.shape[:2]
        brightness = radiance.double() @ torch.tensor(LUMINANCE, dtype=torch.float64, device=radiance.device)
        angles = row_solid_angles(height, width, device=radiance.device)[:, None]
        mean = (brightness * angles).sum() / (4.0 * math.pi)
        chances = (brightness + FLOOR * mean + 1e-12) * angles
        chances = chances / chances.sum()
        if evenly:
            clipped = (brightness.clamp(max=mean) + FLOOR * mean + 1e-12) * angles
            chances = (1.0 - evenly) * chances + evenly * clipped / clipped.sum()
        by_row = chances.sum(dim=1)
        rows = torch.nn.functional.pad(by_row.cumsum(dim=0), (1, 0))
        columns = torch.nn.functional.pad((chances / by_row[:, None]).cumsum(dim=1), (1, 0))
        return cls(
            radiance.contiguous(),
            (rows / rows[-1]).float(),
            (columns / columns[:, -1:]).float().contiguous(),
            (chances / angles).float(),
            wrap_equirect(_irradiance(radiance)).contiguous(),
        )


def _irradiance(radiance: Tensor) -> Tensor:
    """(64, 128, 3) float32 irradiance by the surface's normal, from (H, W, 3) radiance.

    The sky is a sum of blocks, each with its exact vector irradiance: only at a block that the surface's own
    horizon cuts is that the least bit too much or too little.
    """
    height, width = radiance.shape[:2]
    rows, columns = math.gcd(height, IRRADIANCE_ROWS), math.gcd(width, 2 * IRRADIANCE_ROWS)
    angles = row_solid_angles(height, width, device=radiance.device)[:, None, None]
    directions = equirect_directions(height, device=radiance.device)
    normals = equirect_directions(IRRADIANCE_ROWS, device=radiance.device)
    result = torch.empty_like(normals)
    facing = normals.new_empty(2 * IRRADIANCE_ROWS, rows * columns)  # a third of the time went to new ones
    for channel in range(3):
        vectors = radiance[..., channel, None].double() * angles * directions
        blocks = (
            vectors.view(rows, height // rows, columns, width // columns, 3)
            .sum(dim=(1, 3))
            .float()
            .view(-1, 3)
        )
        for row in range(IRRADIANCE_ROWS):
            result[row, :, channel] = torch.mm(normals[row], blocks.T, out=facing).clamp_(min=0.0).sum(dim=1)
    return result


@wp.struct
class Sky:
    """`SkyTables` inside a kernel."""

    radiance: wp.array2d[wp.vec3]
    rows: wp.array[wp.float32]
    columns: wp.array2d[wp.float32]
    density: wp.array2d[wp.float32]
    irradiance: wp.array2d[wp.vec3]


@wp.struct
class SkySample:
    """What the sky holds in one direction.

    Attributes:
        direction: Unit.
        radiance: Linear.
        density: Chance per steradian that `sample_sky` draws it.
    """

    direction: wp.vec3
    radiance: wp.vec3
    density: wp.float32


@wp.func
def look_at_sky(sky: Sky, direction: wp.vec3) -> SkySample:
    """The texel in a direction: the centre column lies along -z, the right-hand quarter along +x."""
    height = sky.density.shape[0]
    width = sky.density.shape[1]
    u = 0.5 + wp.atan2(direction[0], -direction[2]) / (2.0 * PI)
    v = wp.acos(wp.clamp(direction[1], -1.0, 1.0)) / PI
    column = wp.clamp(wp.int32(u * wp.float32(width)), 0, width - 1)
    row = wp.clamp(wp.int32(v * wp.float32(height)), 0, height - 1)
    sample = SkySample()
    sample.direction = direction
    sample.radiance = sky.radiance[row, column]
    sample.density = sky.density[row, column]
    return sample


@wp.func
def look_up_irradiance(sky: Sky, normal: wp.vec3) -> wp.vec3:
    """Irradiance of a surface that faces a unit direction, bilinear."""
    height = sky.irradiance.shape[0] - 2
    width = sky.irradiance.shape[1] - 2
    x = wp.float32(width) * (0.5 + wp.atan2(normal[0], -normal[2]) / (2.0 * PI)) + 0.5
    y = wp.float32(height) * (wp.acos(wp.clamp(normal[1], -1.0, 1.0)) / PI) + 0.5
    column = wp.clamp(wp.int32(x), 0, width)
    row = wp.clamp(wp.int32(y), 0, height)
    across = x - wp.float32(column)
    down = y - wp.float32(row)
    upper = (1.0 - across) * sky.irradiance[row, column] + across * sky.irradiance[row, column + 1]
    lower = (1.0 - across) * sky.irradiance[row + 1, column] + across * sky.irradiance[row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


@wp.func
def _find_row(rows: wp.array[wp.float32], value: wp.float32) -> wp.int32:
    """The last index whose cumulated chance does not exceed ``value``."""
    low = wp.int32(0)
    high = wp.int32(rows.shape[0] - 1)
    while high - low > 1:
        middle = (low + high) // 2
        if rows[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@wp.func
def _find_column(columns: wp.array2d[wp.float32], row: wp.int32, value: wp.float32) -> wp.int32:
    """As `_find_row`, within a row."""
    low = wp.int32(0)
    high = wp.int32(columns.shape[1] - 1)
    while high - low > 1:
        middle = (low + high) // 2
        if columns[row, middle] <= value:
            low = middle
        else:
            high = middle
    return low


@wp.func
def sample_sky(sky: Sky, u: wp.vec2) -> SkySample:
    """Draw a direction by brightness; what choosing the texel leaves of each number places it within."""
    height = sky.density.shape[0]
    width = sky.density.shape[1]
    row = _find_row(sky.rows, u[0])
    column = _find_column(sky.columns, row, u[1])
    down = wp.clamp((u[0] - sky.rows[row]) / (sky.rows[row + 1] - sky.rows[row]), 0.0, 1.0)
    across = wp.clamp(
        (u[1] - sky.columns[row, column]) / (sky.columns[row, column + 1] - sky.columns[row, column]),
        0.0,
        1.0,
    )
    upper = wp.cos(PI * wp.float32(row) / wp.float32(height))
    lower = wp.cos(PI * wp.float32(row + 1) / wp.float32(height))
    up = upper + down * (lower - upper)
    azimuth = 2.0 * PI * ((wp.float32(column) + across) / wp.float32(width) - 0.5)
    radius = wp.sqrt(wp.max(1.0 - up * up, 0.0))
    sample = SkySample()
    sample.direction = wp.vec3(radius * wp.sin(azimuth), up, -radius * wp.cos(azimuth))
    sample.radiance = sky.radiance[row, column]
    sample.density = sky.density[row, column]
    return sample


@wp.func
def _reverse_bits(value: wp.uint32) -> wp.uint32:
    x = value
    x = ((x >> wp.uint32(1)) & wp.uint32(0x55555555)) | ((x & wp.uint32(0x55555555)) << wp.uint32(1))
    x = ((x >> wp.uint32(2)) & wp.uint32(0x33333333)) | ((x & wp.uint32(0x33333333)) << wp.uint32(2))
    x = ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F)) | ((x & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    x = ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF)) | ((x & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    return (x >> wp.uint32(16)) | (x << wp.uint32(16))


@wp.func
def _permute(value: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Owen's scrambling of reversed bits by a hash (Laine and Karras, 2011).

    In it each bit depends on lower ones alone.
    """
    x = value + seed
    x = x ^ (x * _HASH_0)
    x = x ^ (x * _HASH_1)
    x = x ^ (x * _HASH_2)
    return x ^ (x * _HASH_3)


@wp.func
def _second_sobol(index: wp.uint32) -> wp.uint32:
    """Sobol's second dimension, bits reversed."""
    result = wp.uint32(0)
    direction = wp.uint32(1)
    rest = index
    while rest != wp.uint32(0):
        if (rest & wp.uint32(1)) != wp.uint32(0):
            result = result ^ direction
        rest = rest >> wp.uint32(1)
        direction = direction ^ (direction << wp.uint32(1))
    return result


@wp.func
def draw_point(index: wp.int32, seed: wp.uint32) -> wp.vec2:
    """Point ``index`` of a sequence in [0, 1)^2 whose first 2^n points are stratified.

    Seeds give unrelated orders and scramblings. Shuffled, scrambled Sobol points (Burley, Practical
    Hash-based Owen Scrambling, 2020).
    """
    state = wp.rand_init(wp.int32(seed), 0)
    shuffled = _reverse_bits(_permute(_reverse_bits(wp.uint32(index)), wp.randu(state)))
    x = _reverse_bits(_permute(shuffled, wp.randu(state)))
    y = _reverse_bits(_permute(_second_sobol(shuffled), wp.randu(state)))
    unit = 1.0 / 16777216.0
    return wp.vec2(wp.float32(x >> wp.uint32(8)) * unit, wp.float32(y >> wp.uint32(8)) * unit)


@wp.func
def sample_lit_sky(sky: Sky, normal: wp.vec3, number: wp.int32, seed: wp.uint32) -> SkySample:
    """A direction drawn by brightness and by its cosine with a unit normal.

    Its density is 0 where none of the candidates lies above the surface. One of some candidates by
    brightness, chosen by their cosines: resampled importance sampling (Talbot, Cline and Egbert, 2005). What
    is called density makes radiance x cosine / density an unbiased estimate.
    """
    # number 0 is what scrambles the points
    state = wp.rand_init(wp.int32(seed), number + 1)
    total = wp.float32(0.0)
    chosen = SkySample()
    for candidate in range(CANDIDATES):
        sample = sample_sky(sky, draw_point(number * CANDIDATES + candidate, seed))
        cosine = wp.max(wp.dot(normal, sample.direction), 0.0)
        total += cosine
        if cosine > 0.0 and wp.randf(state) * total < cosine:
            chosen.direction = sample.direction
            chosen.radiance = sample.radiance
            chosen.density = sample.density * cosine
    chosen.density = chosen.density * wp.float32(CANDIDATES) / wp.max(total, 1.0e-6)
    return chosen
