"""Eyelids that slide over their eyeballs.

A linear blink cuts through the ball half-way, so what lies within is moved out of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from samira_warp.head.template import HeadTemplate

CLEARANCE = 3e-4
"""Metres between an eyeball and the skin upon it."""

REACH = 2.0
"""Radii around an eyeball's centre within which skin may come upon it."""

BLUR = math.radians(6.0)
"""Angle over which an eyeball's radius is averaged: some two of its edges."""

EYEBALLS = ("left_eyeball", "right_eyeball")
"""Masks of a template that hold them."""


@dataclass(frozen=True, eq=False)
class Eyelids:
    """The skin near one eyeball, and the eyeball's form at rest.

    Attributes:
        skin: (K,) int64 vertices of the finer mesh that lie within reach and belong to no eyeball.
        joint: The joint that turns the eyeball.
        center: (3,) float32 middle of the eyeball at rest, metres.
        directions: (N, 3) float32 unit directions of the eyeball's vertices from there.
        radii: (N,) float32 their distances, metres.
    """

    skin: Tensor
    joint: int
    center: Tensor
    directions: Tensor
    radii: Tensor

    @classmethod
    def both(cls, template: HeadTemplate, rest: Tensor, in_eyeball: dict[str, Tensor]) -> tuple[Eyelids, ...]:
        """The lids of every eyeball that the template has.

        Args:
            template: The head.
            rest: (V', 3) float32 vertices of the finer mesh at rest.
            in_eyeball: (V',) bool by mask, which of them belong to it.
        """
        of_any = (
            torch.stack([*in_eyeball.values()]).any(dim=0)
            if in_eyeball
            else torch.zeros(len(rest), dtype=torch.bool)
        )
        return tuple(cls._one(template, rest, name, members, of_any) for name, members in in_eyeball.items())

    @classmethod
    def _one(
        cls,
        template: HeadTemplate,
        rest: Tensor,
        name: str,
        members: Tensor,
        of_any: Tensor,
    ) -> Eyelids:
        center = torch.from_numpy(_sphere_center(rest[members].numpy()))
        spokes = rest[members] - center
        radii = spokes.norm(dim=1)
        near = (rest - center).norm(dim=1) < REACH * radii.max()
        joint = int(template.weights[template.masks[name]].sum(axis=0).argmax())
        return cls((near & ~of_any).nonzero().squeeze(1), joint, center, spokes / radii[:, None], radii)

    def clear(self, vertices: Tensor, joint_transforms: Tensor) -> Tensor:
        """Move skin out of the eyeball.

        Args:
            vertices: (V', 3) float32 posed finer mesh, metres.
            joint_transforms: (J, 4, 4) float32 of the pose (`PosedHead`).

        Returns:
            (V', 3) float32.
        """
        rotation, shift = joint_transforms[self.joint, :3, :3], joint_transforms[self.joint, :3, 3]
        spokes = (vertices[self.skin] - shift) @ rotation - self.center
        distance = spokes.norm(dim=1).clamp(min=1e-6)
        nearness = torch.softmax((spokes / distance[:, None]) @ self.directions.T / BLUR**2, dim=1)
        wanted = nearness @ self.radii + CLEARANCE
        moved = spokes * (wanted / distance).clamp(min=1.0)[:, None]
        result = vertices.clone()
        result[self.skin] = (moved + self.center) @ rotation.T + shift
        return result


def _sphere_center(points: np.ndarray) -> np.ndarray:
    """(3,) float32 centre of the sphere that fits (N, 3) points best.

    For |p|^2 = 2 p c + (r^2 - |c|^2) is linear in c and the rest.
    """
    points = points.astype(np.float64)
    system = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
    solution, *_ = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)
    return solution[:3].astype(np.float32)
