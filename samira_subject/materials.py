"""The built-in head's surface: colour, finish, bumps, and wrinkles that come with its expressions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.head import SubjectHead
from samira_subject.paint.bumps import WRINKLES, Slopes, Wrinkle, resting_heights, wrinkle_heights
from samira_subject.paint.hair import brow_share, scalp_share, with_brows, with_scalp
from samira_subject.paint.layer import Paint
from samira_subject.paint.look import Look, look_of
from samira_subject.paint.organs import eye_paint, mouth_paint, teeth_paint, tongue_paint
from samira_subject.paint.patches import with_patches
from samira_subject.paint.skin import (
    skin_paint,
    with_beard,
    with_freckles,
    with_lid_edges,
    with_lips,
    with_nostrils,
)
from samira_subject.paint.texels import Texels


class _Groove(NamedTuple):
    """A wrinkle on one side.

    Attributes:
        drivers: (E,) how strongly expressions open it.
        texels: (K,) flat ids of the texels that it touches.
        slopes: (K, 3) what it adds to theirs.
    """

    drivers: Tensor
    texels: Tensor
    slopes: Tensor


@dataclass(frozen=True, eq=False)
class Materials:
    """What a head's surface is made of, in its UV layout; all float32 on the CPU.

    Attributes:
        albedo: (S, S, 3) linear diffuse reflectance.
        finish: (S, S, 3) roughness, reflectance at normal incidence, and how much the surface scatters light
            below it.
        resting: (S, S, 3) gradient over the rest head of the bumps' height when the face is at rest.
        grooves: The wrinkles.
    """

    albedo: Tensor
    finish: Tensor
    resting: Tensor
    grooves: tuple[_Groove, ...]

    def relief(self, expression: Tensor, jaw: float) -> Tensor:
        """(S, S, 3) gradient over the rest head of the bumps' height.

        Args:
            expression: (E,) coefficients of the head's expressions.
            jaw: Opening of the jaw, radians; it stretches cheeks and lips, and smooths their wrinkles.
        """
        slopes = self.resting.clone()
        flat = slopes.view(-1, 3)
        for groove in self.grooves:
            strength = float((groove.drivers * expression.clamp(0.0, 1.0)).sum().clamp(max=1.0))
            if strength > 0.0:
                flat[groove.texels] += strength * max(1.0 - jaw, 0.5) * groove.slopes
        return slopes


def paint(head: SubjectHead, *, seed: int, size: int, patches: bool = False) -> Materials:
    """Paint a head.

    Args:
        head: The head.
        seed: Whose colours.
        size: S, width and height of the maps.
        patches: Show how hair and collar move (`samira_subject.paint.patches`).
    """
    texels = Texels.build(head.anatomy, size=size)
    look = look_of(seed)
    hair, brows = scalp_share(texels, seed=seed), brow_share(texels, seed=seed)
    surface = _surface(texels, look, hair, brows, seed=seed)
    if patches:
        surface = with_patches(surface, texels, hair, seed=seed)
    slopes = Slopes(texels, _chart_gradients(head.anatomy, texels.face))
    resting = slopes.of(resting_heights(texels, hair=hair, brows=brows, seed=seed))
    finish = np.stack([surface.roughness, surface.specular, surface.scatter], axis=1)
    return Materials(
        albedo=_map(texels, np.clip(surface.albedo, 0.002, 0.9)),
        finish=_map(texels, np.clip(finish, (0.08, 0.02, 0.0), (1.0, 0.15, 1.0))),
        resting=_map(texels, resting),
        grooves=tuple(
            _groove(texels, slopes, wrinkle, head.template.expression_names, left=left)
            for wrinkle in WRINKLES
            for left in (True, False)
        ),
    )


def _map(texels: Texels, values: np.ndarray) -> Tensor:
    return torch.from_numpy(texels.spread(values).astype(np.float32))


def _surface(t: Texels, look: Look, hair: np.ndarray, brows: np.ndarray, *, seed: int) -> Paint:
    """Every part under its own paint; (N,) shares of the crop and of the brows."""
    skin = with_freckles(skin_paint(t, look, seed=seed), t, look, seed=seed)
    skin = with_beard(with_nostrils(skin, t), t, look, seed=seed)
    skin = with_brows(with_scalp(skin, t, look, hair, seed=seed), look, brows)
    skin = with_lid_edges(with_lips(skin, t, look, seed=seed), t, look)
    inner = t.is_part("mouth") * np.clip((-t.lip - 17.0) / 4.0, 0.0, 1.0)
    surface = skin.under(mouth_paint(t, seed=seed), inner)
    for names, other in (
        (("left_eyeball", "right_eyeball"), eye_paint(t, look, seed=seed)),
        (("teeth_upper", "teeth_lower"), teeth_paint(t, seed=seed)),
        (("tongue",), tongue_paint(t, seed=seed)),
    ):
        surface = surface.under(other, t.is_part(*names).astype(float))
    return surface


def _chart_gradients(a: Anatomy, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) gradients of u and of v over (N,) faces of the mean head, per millimetre."""
    corners, charts = a.points[a.faces], a.vt[a.ft]
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.maximum((normal**2).sum(axis=1), 1e-6)
    basis = np.cross(normal[:, None], opposite) / doubled[:, None, None]
    u, v = (np.einsum("fk,fkc->fc", charts[:, :, axis], basis) for axis in (0, 1))
    return u[face], v[face]


def _groove(t: Texels, slopes: Slopes, wrinkle: Wrinkle, names: tuple[str, ...], *, left: bool) -> _Groove:
    """A wrinkle on one side, ready to be added."""
    gradient = slopes.of(wrinkle_heights(t, wrinkle, left=left))
    touched = np.abs(gradient).max(axis=1) > 1e-4
    flat = np.flatnonzero(t.covered)[touched]
    drivers = torch.zeros(len(names))
    for name, strength in wrinkle.drivers.items():
        sided = f"{name}_{'L' if left else 'R'}"
        drivers[names.index(sided if sided in names else name)] = strength
    return _Groove(drivers, torch.from_numpy(flat), torch.from_numpy(gradient[touched].astype(np.float32)))
