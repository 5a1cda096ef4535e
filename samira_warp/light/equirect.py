"""Equirectangular panoramas to cubemaps and back.

Direction d sees column u = 0.5 + atan2(d.x, -d.z) / (2 pi) + rotate / 360 (mod 1, from the left) and row
acos(d.y) / pi (from the top): the centre column lies straight ahead of the camera (-z), the right-hand
quarter along +x. Panoramas are read with rotate = 0; a light that is turned is looked up in other directions
(`turn_directions`).
"""

from __future__ import annotations

import math
from numbers import Real

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import FACES, texel_directions, texel_solid_angles
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor

_SAMPLES_PER_PIXEL = 3
"""Samples per pixel of the panorama, along each axis: a lamp of one pixel keeps its energy to a few percent,
a map to some 1e-3."""

VALUES_AT_ONCE = 1 << 22
"""Numbers of a map that are worked on at once: a large one leaves no room for copies of itself."""


def equirect_to_cube(equirect: Tensor, *, size: int) -> Tensor:
    """Resample a panorama as a cubemap; each texel is the mean over its solid angle.

    A panorama much finer than the cubemap is first averaged by solid angle in whole blocks of pixels, then
    every texel averages samples three times as dense as the remaining pixels, so no light falls between them.
    A uniform map stays uniform; means are kept to some 1e-3.

    Args:
        equirect: (H, W, C) float32, linear.
        size: S.

    Returns:
        (6, S, S, C) float32, differentiable in ``equirect``.

    Raises:
        UserError: A wrong shape or dtype, or no pixels.
    """
    check_tensor("equirect", equirect, shape=("H", "W", "C"))
    if min(equirect.shape) == 0 or size < 1:
        raise UserError(
            "equirect",
            expected="at least one pixel, for a cubemap of at least one texel",
            found=f"{tuple(equirect.shape)}, {size}",
        )
    equirect = _shrink(equirect, columns=4 * size)
    samples = max(2, math.ceil(_SAMPLES_PER_PIXEL * equirect.shape[1] / (4 * size)))
    directions = texel_directions(size, device=equirect.device, supersample=samples).view(
        FACES, size, samples, size, samples, 3
    )
    areas = texel_solid_angles(size * samples, device=equirect.device).view(size, samples, size, samples)
    padded = wrap_equirect(equirect)
    total = equirect.new_zeros(FACES, size, size, equirect.shape[2])
    for j in range(samples):
        for i in range(samples):
            total = total + areas[:, j, :, i, None] * _look_up(padded, directions[:, :, j, :, i])
    return total / areas.sum(dim=(1, 3))[..., None]


def cube_to_equirect(cubemap: Tensor, *, height: int) -> Tensor:
    """Resample a cubemap (6, S, S, C) float32 as a panorama (height, 2 height, C) with rotate = 0.

    Differentiable. Each pixel averages samples at least as dense as the texels.
    """
    samples = max(1, math.ceil(2 * cubemap.shape[1] / height))
    directions = equirect_directions(height * samples, device=cubemap.device)
    seen = sample_cubemap(cubemap, directions.view(-1, 3))
    return seen.view(height, samples, 2 * height, samples, -1).mean(dim=(1, 3))


def direction_to_equirect(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Column u and row v, each (...) in [0, 1], that unit directions (..., 3) see with rotate = 0."""
    u = 0.5 + torch.atan2(directions[..., 0], -directions[..., 2]) / (2 * math.pi)
    v = torch.acos(directions[..., 1].clamp(-1, 1)) / math.pi
    return u - torch.floor(u), v


def row_solid_angles(height: int, width: int, *, device: torch.device | str = "cpu") -> Tensor:
    """(height,) float64 solid angle of a panorama's pixels by row, exact, steradians."""
    edges = torch.cos(torch.linspace(0.0, math.pi, height + 1, dtype=torch.float64, device=device))
    return (edges[:-1] - edges[1:]) * (2.0 * math.pi / width)


def turn_directions(directions: Tensor, rotate: float) -> Tensor:
    """Where to look up, in a light as it was, what directions see of it once it is turned.

    Args:
        directions: (..., 3) unit directions.
        rotate: Degrees by which the light is turned.

    Raises:
        UserError: They are no directions.
    """
    if directions.shape[-1:] != (3,):
        raise UserError("directions", expected="(..., 3)", found=tuple(directions.shape))
    cosine, sine = math.cos(math.radians(rotate)), math.sin(math.radians(rotate))
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([cosine * x - sine * z, y, sine * x + cosine * z], dim=-1)


def check_degrees(degrees: float) -> None:
    """Raise UserError unless ``degrees`` are finite."""
    if not (isinstance(degrees, Real) and math.isfinite(degrees)):
        raise UserError("rotate", expected="degrees", found=degrees)


def equirect_directions(height: int, *, device: torch.device | str = "cpu") -> Tensor:
    """(height, 2 height, 3) float32 unit directions of a panorama's pixel centres, rotate = 0."""
    polar = (torch.arange(height, dtype=torch.float64, device=device) + 0.5) * (math.pi / height)
    around = (torch.arange(2 * height, dtype=torch.float64, device=device) + 0.5) * (
        math.pi / height
    ) - math.pi
    polar, around = torch.meshgrid(polar, around, indexing="ij")
    directions = [
        torch.sin(polar) * torch.sin(around),
        torch.cos(polar),
        -torch.sin(polar) * torch.cos(around),
    ]
    return torch.stack(directions, dim=-1).to(torch.float32)


def wrap_equirect(equirect: Tensor, *, border: int = 1) -> Tensor:
    """(H + 2 border, W + 2 border, C) panorama with what lies beyond its edges.

    Beyond the seam comes the other end of the row, beyond a pole its other side.
    """
    height, width = equirect.shape[:2]
    rows = torch.arange(-border, height + border, device=equirect.device)
    columns = torch.arange(-border, width + border, device=equirect.device)
    over_pole = (rows < 0) | (rows >= height)
    rows = torch.where(rows < 0, -1 - rows, torch.where(rows >= height, 2 * height - 1 - rows, rows)).clamp(
        0, height - 1
    )
    columns = (columns + over_pole[:, None] * (width // 2)) % width
    return equirect[rows[:, None], columns]


def _shrink(equirect: Tensor, *, columns: int) -> Tensor:
    """Average whole blocks of pixels, weighted by solid angle, while enough columns are left."""
    height, width, channels = equirect.shape
    factor = math.gcd(height, width)
    factor = max(f for f in range(1, factor + 1) if factor % f == 0 and (f == 1 or width // f >= columns))
    if factor == 1:
        return equirect
    weights = (
        row_solid_angles(height, width, device=equirect.device).to(equirect.dtype).view(-1, factor, 1, 1)
    )
    blocks = equirect.view(height // factor, factor, width // factor, factor * channels)
    rows = equirect.new_empty(height // factor, width // factor, factor * channels)
    at_once = max(VALUES_AT_ONCE // (factor * width * channels), 1)
    for first in range(0, len(rows), at_once):
        some, weight = (values[first : first + at_once] for values in (blocks, weights))
        rows[first : first + at_once] = (some * weight).sum(dim=1) / weight.sum(dim=1)
    return rows.view(height // factor, width // factor, factor, channels).mean(dim=2)


def _look_up(padded: Tensor, directions: Tensor) -> Tensor:
    """(..., C) bilinear values of a panorama with one pixel of border."""
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    u, v = direction_to_equirect(directions)
    # Pixel centres of the panorama lie at 1.5, 2.5, ... of the padded one.
    grid = torch.stack(
        [2 * (u * width + 1) / (width + 2) - 1, 2 * (v * height + 1) / (height + 2) - 1], dim=-1
    ).view(1, 1, -1, 2)
    pixels = padded.permute(2, 0, 1)[None]
    seen = torch.nn.functional.grid_sample(pixels, grid, padding_mode="border", align_corners=False)
    return seen[0, :, 0].T.view(*directions.shape[:-1], -1)
