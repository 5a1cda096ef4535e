"""Lamps about a head: point, directional and rectangular, as they are seen from its centre.

Positions are metres from the head's centre in the axes of the world: +y up, +z where the face looks, +x the
subject's left. Colours are linear Rec. 709, in the units of a map's radiance L: what a lamp throws on a
surface is its irradiance E, the integral of L cos over solid angle (shading works with E_d = E / pi, the mean
of L weighted by the cosine). A white card of E = pi is as bright as a map of L = 1 all around makes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Protocol, TypeGuard

import torch
from torch import Tensor

from samira_warp.support.errors import UserError

Triple = tuple[float, float, float]
"""Coordinates, or red, green and blue."""

HEAD_RADIUS = 0.12
"""Metres about the head's centre in which no lamp can be."""

FARTHEST, SHORTEST, BRIGHTEST = 1000.0, 0.001, 1e9
"""Bounds of what is a lamp: metres to it, metres along its side, and its power. What is beyond is a mistaken
unit, and would be lost in rounding."""

WIDEST = 60.0
"""Degrees of radius that a round lamp may have."""

DISC_RADIUS = 0.5
"""Degrees: the radius that point and directional lamps are given, twice the sun's; a texel and a half of a
cubemap of 256."""

EDGE_ON = 0.01
"""Cosine between an area light's normal and the way to the head at which it shows its edge."""

_DISC_CORNERS = 24
"""Of the polygon that stands for a round lamp."""


class Lamp(Protocol):
    """What a rig is made of."""

    def check(self, subject: object) -> None:
        """Raise UserError, about ``subject``, unless every number can be used."""

    def outline(self) -> Tensor:
        """(N, 3) float64 corners of the convex polygon that the head's centre sees."""

    def irradiance_vector(self) -> Tensor:
        """(3, 3) float64, a row each for red, green and blue: the integral of L times direction.

        Its product with the normal of a surface at the head's centre that has the whole lamp before it is E.
        """


@dataclass(frozen=True)
class DirectionalLight:
    """A round lamp infinitely far away, such as the sun.

    Attributes:
        direction: From the head to the lamp, of any length.
        irradiance: E on a surface that faces it.
        radius: Degrees from its middle to its edge.
        name: What messages call it.
    """

    direction: Triple
    irradiance: Triple
    radius: float = DISC_RADIUS
    name: str = ""

    def check(self, subject: object) -> None:
        """Raise UserError, about ``subject``, unless every number can be used."""
        _check_vector(subject, "direction", self.direction)
        _check_color(subject, "irradiance", self.irradiance)
        _check_between(subject, "radius", self.radius, 0.0, WIDEST, unit="degrees")

    def outline(self) -> Tensor:
        """(24, 3) float64 corners of the disc at a distance of 1."""
        return _disc(_unit(self.direction), self.radius)

    def irradiance_vector(self) -> Tensor:
        """(3, 3) float64: `Lamp.irradiance_vector`."""
        return _vector(self.irradiance)[:, None] * _unit(self.direction)


@dataclass(frozen=True)
class PointLight:
    """A small lamp that shines alike in all directions.

    Attributes:
        position: Metres from the head's centre.
        intensity: Per steradian: E = intensity / distance^2 on a surface that faces it.
        radius: Degrees from its middle to its edge, as the head's centre sees it.
        name: What messages call it.
    """

    position: Triple
    intensity: Triple
    radius: float = DISC_RADIUS
    name: str = ""

    def check(self, subject: object) -> None:
        """Raise UserError, about ``subject``, unless every number can be used."""
        _check_position(subject, self.position)
        _check_color(subject, "intensity", self.intensity)
        _check_between(subject, "radius", self.radius, 0.0, WIDEST, unit="degrees")
        _check_outside(subject, "position", math.hypot(*self.position))

    def outline(self) -> Tensor:
        """(24, 3) float64 corners of the disc at a distance of 1."""
        return _disc(_unit(self.position), self.radius)

    def irradiance_vector(self) -> Tensor:
        """(3, 3) float64: `Lamp.irradiance_vector`."""
        return _vector(self.intensity)[:, None] * _unit(self.position) / math.hypot(*self.position) ** 2


@dataclass(frozen=True)
class AreaLight:
    """A rectangle that shines on its front with one radiance in all directions, such as a softbox.

    Its width is level, or along x where it faces straight up or down.

    Attributes:
        position: Of its middle, metres from the head's centre.
        radiance: L.
        width: Metres.
        height: Metres.
        normal: Where its front faces, of any length; None is towards the head's centre.
        name: What messages call it.
    """

    position: Triple
    radiance: Triple
    width: float
    height: float
    normal: Triple | None = None
    name: str = ""

    def check(self, subject: object) -> None:
        """Raise UserError, about ``subject``, unless its numbers can be used and it faces the head."""
        _check_position(subject, self.position)
        _check_color(subject, "radiance", self.radiance)
        for key, side in (("width", self.width), ("height", self.height)):
            _check_between(subject, key, side, SHORTEST, FARTHEST, unit="metres")
        _check_outside(subject, "position", math.hypot(*self.position))
        if self.normal is not None:
            _check_vector(subject, "normal", self.normal)
        _check_outside(subject, "the lamp's nearest part", self._nearest())
        if float(self._facing() @ _unit(self.position)) > -EDGE_ON:
            found = "one that shows it its back or its edge"
            raise UserError(subject, expected="a lamp whose front faces the head", found=found)

    def outline(self) -> Tensor:
        """(4, 3) float64 corners, metres, so that its front is on the side of the head."""
        across, up = self._sides()
        signs = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
        corners = [0.5 * (x * self.width * across + y * self.height * up) for x, y in signs]
        return _vector(self.position) + torch.stack(corners)

    def irradiance_vector(self) -> Tensor:
        """(3, 3) float64: `Lamp.irradiance_vector`, Lambert's formula for a polygon.

        Each edge gives half the angle that it spans, along the normal of its plane through the centre.
        """
        corners = torch.nn.functional.normalize(self.outline(), dim=1)
        following = corners.roll(-1, dims=0)
        normals = torch.linalg.cross(corners, following)
        angles = torch.atan2(normals.norm(dim=1), (corners * following).sum(dim=1))
        vector = 0.5 * (angles[:, None] * torch.nn.functional.normalize(normals, dim=1)).sum(dim=0)
        return _vector(self.radiance)[:, None] * vector * torch.sign(vector @ _vector(self.position))

    def _facing(self) -> Tensor:
        """(3,) float64 unit normal of the front."""
        return -_unit(self.position) if self.normal is None else _unit(self.normal)

    def _sides(self) -> tuple[Tensor, Tensor]:
        """(3,) float64 unit vectors along its width and its height."""
        facing = self._facing()
        across = torch.linalg.cross(_vector((0.0, 1.0, 0.0)), facing)
        if float(across.norm()) < 1e-6:
            across = _vector((1.0, 0.0, 0.0))
        across = torch.nn.functional.normalize(across, dim=0)
        return across, torch.linalg.cross(facing, across)

    def _nearest(self) -> float:
        """Metres from the head's centre to the rectangle."""
        middle = _vector(self.position)
        point = middle.clone()
        for side, extent in zip(self._sides(), (self.width, self.height), strict=True):
            point += side * (-middle @ side).clamp(-0.5 * extent, 0.5 * extent)
        return float(point.norm())


def _disc(direction: Tensor, radius: float) -> Tensor:
    """(24, 3) float64 corners of a regular polygon, radius in degrees, on the plane at a distance of 1."""
    aside = torch.zeros_like(direction)
    aside[int(direction.abs().argmin())] = 1.0
    first = torch.nn.functional.normalize(torch.linalg.cross(direction, aside), dim=0)
    second = torch.linalg.cross(direction, first)
    turns = torch.arange(_DISC_CORNERS, dtype=torch.float64)[:, None] * (2.0 * math.pi / _DISC_CORNERS)
    return direction + math.tan(math.radians(radius)) * (turns.cos() * first + turns.sin() * second)


def _vector(values: Triple) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _unit(values: Triple) -> Tensor:
    return _vector(values) / math.hypot(*values)


def _is_number(value: object) -> TypeGuard[float]:
    """Whether it is one that a float holds: no truth value, no NaN, no whole number of 400 digits."""
    return isinstance(value, Real) and not isinstance(value, bool) and abs(value) < 1e30  # type: ignore[operator]


def _is_triple(values: object) -> TypeGuard[Triple]:
    return isinstance(values, (tuple, list)) and len(values) == 3 and all(map(_is_number, values))


def _check_position(subject: object, position: object) -> None:
    expected = f"three numbers, metres from the head's centre, at most {FARTHEST:g}"
    if not (_is_triple(position) and math.hypot(*position) <= FARTHEST):
        raise UserError(f"{subject}, position", expected=expected, found=position)


def _check_vector(subject: object, key: str, vector: object) -> None:
    if not (_is_triple(vector) and 1e-6 < math.hypot(*vector) < 1e6):
        raise UserError(f"{subject}, {key}", expected="three numbers, not all of them 0", found=vector)


def _check_color(subject: object, key: str, color: object) -> None:
    if not (_is_triple(color) and all(0.0 <= value <= BRIGHTEST for value in color)):
        expected = f"linear red, green and blue, 0 to {BRIGHTEST:g}"
        raise UserError(f"{subject}, {key}", expected=expected, found=color)


def _check_between(
    subject: object, key: str, value: object, least: float, greatest: float, *, unit: str
) -> None:
    if not _is_number(value) or not (least <= value <= greatest and value > 0.0):
        bounds = f"{least:g}" if least > 0.0 else "above 0"
        expected = f"{bounds} to {greatest:g} {unit}"
        raise UserError(f"{subject}, {key}", expected=expected, found=value)


def _check_outside(subject: object, what: str, distance: float) -> None:
    if distance < HEAD_RADIUS:
        expected = f"at least {HEAD_RADIUS:g} m from the head's centre, outside the head"
        raise UserError(f"{subject}, {what}", expected=expected, found=f"{distance:.3g} m")
