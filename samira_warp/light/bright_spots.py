"""The small bright parts of a light, which cast shadows with edges: suns, lamps, windows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light.color import LUMINANCE

SPOTS = 32
"""Directions that stand for them: two packets of rays a vertex."""

BRIGHT = 10.0
"""How many times as bright as the mean of the map a texel is that counts."""

LEAST_SHARE = 0.02
"""Of the light's power: less in bright texels is left with the rest, and costs no rays."""

SPREAD, SPREAD_RADIUS = 8, math.radians(2.0)
"""Directions that a texel is spread over, within a disc: at a nose's height the edge of a shadow is then as
wide as the mesh's triangles, and moves over them without steps."""


class BrightSpots(NamedTuple):
    """A light's bright parts as directions, and what they hold.

    Attributes:
        directions: (32, 3) float32 unit vectors in the light's axes; zero where there are fewer.
        powers: (32, 3) float32 radiance times solid angle.
    """

    directions: Tensor
    powers: Tensor

    def to(self, device: torch.device | str) -> BrightSpots:
        """The same on ``device``."""
        return BrightSpots(self.directions.to(device), self.powers.to(device))


class Divided(NamedTuple):
    """A light in two parts, whose sum it is.

    Attributes:
        spots: Its bright parts; None where it has none.
        rest: (6, S, S, 3) float32 radiance of the rest.
    """

    spots: BrightSpots | None
    rest: Tensor


def divide(radiance: Tensor) -> Divided:
    """Take the bright texels out of a light, and gather them into a few directions by median cut.

    The texels are split where their power halves, along the axis in which they spread most, and so on
    (Debevec 2005, "A Median Cut Algorithm for Light Probe Sampling"). Power is kept to rounding.

    Args:
        radiance: (6, S, S, 3) float32 linear; a constant.
    """
    luminance = radiance @ radiance.new_tensor(LUMINANCE)
    areas = texel_solid_angles(radiance.shape[1], device=radiance.device)
    power = luminance * areas
    mean = power.sum() / (4.0 * math.pi)
    bright = luminance > BRIGHT * mean
    if float(power[bright].sum()) <= LEAST_SHARE * float(power.sum()):
        return Divided(None, radiance)
    directions = texel_directions(radiance.shape[1], device=radiance.device)[bright].double().cpu().numpy()
    powers = (radiance * areas[..., None])[bright].double().cpu().numpy()
    spots = _median_cut(_spread(directions), np.repeat(powers / SPREAD, SPREAD, axis=0))
    return Divided(spots.to(radiance.device), torch.where(bright[..., None], 0.0, radiance))


def _spread(directions: np.ndarray) -> np.ndarray:
    """(N SPREAD, 3) directions over a disc about each of (N, 3), in a sunflower's pattern."""
    axis = np.where(np.abs(directions[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(axis, directions)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(directions, across)
    place = np.arange(SPREAD)
    radius = np.tan(SPREAD_RADIUS) * np.sqrt((place + 0.5) / SPREAD)
    angle = place * math.pi * (3.0 - math.sqrt(5.0))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return (directions[:, None] + x[:, None] * across[:, None] + y[:, None] * up[:, None]).reshape(-1, 3)


def _median_cut(directions: np.ndarray, powers: np.ndarray) -> BrightSpots:
    """Halve by power until there are SPOTS parts, or all are single."""
    weights = powers @ np.array(LUMINANCE)
    parts = [np.arange(len(directions))]
    while len(parts) < SPOTS:
        splittable = [k for k, part in enumerate(parts) if len(part) > 1]
        if not splittable:
            break
        part = parts.pop(max(splittable, key=lambda k: (weights[parts[k]].sum(), -k)))
        places = directions[part]
        center = (weights[part, None] * places).sum(axis=0) / weights[part].sum()
        spread = (weights[part, None] * (places - center) ** 2).sum(axis=0)
        ordered = part[np.argsort(places[:, spread.argmax()], kind="stable")]
        halves = np.cumsum(weights[ordered])
        middle = int(np.searchsorted(halves, 0.5 * halves[-1])) + 1
        middle = min(max(middle, 1), len(ordered) - 1)
        parts += [ordered[:middle], ordered[middle:]]
    found, held = np.zeros((SPOTS, 3)), np.zeros((SPOTS, 3))
    for k, part in enumerate(parts):
        mean = (weights[part, None] * directions[part]).sum(axis=0)
        found[k], held[k] = mean / np.linalg.norm(mean), powers[part].sum(axis=0)
    # neighbours beside one another, as rays are traced in packets of 16
    order = np.lexsort((found[:, 1], found[:, 0], np.linalg.norm(held, axis=1) == 0.0))
    return BrightSpots(torch.from_numpy(found[order]).float(), torch.from_numpy(held[order]).float())
