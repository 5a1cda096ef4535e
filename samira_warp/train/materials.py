"""What a head's surface is like where pictures do not tell: roughness and reflectance as they were measured.

Soft light hardly shows either. Left free, each Gaussian's takes what its own pixels lack, and a relit face is
oily in spots. So they start from measurements, are held near them, and change from Gaussian to Gaussian only
as their neighbours do.

- Skin: index of refraction 1.4, so a reflectance of ((1.4 - 1) / (1.4 + 1))^2 = 0.028, and a Beckmann slope
  of 0.3 that fits most of the faces measured by Weyrich et al. (Analysis of human faces using a
  measurement-based skin reflectance model, 2006), as d'Eon and Luebke have it (GPU Gems 3, chapter 14); the
  slope is GGX's alpha, the square of the roughness here.
- Eyes: the cornea's index is 1.376 (Gullstrand's eye), so 0.025; its film of tears is smooth, as smooth as
  the light's maps can show.
- Mouth: enamel (1.62) and mucosa under saliva (1.33): 0.03, wet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.avatar import Gaussians
from samira_warp.avatar.gaussians import SKIN_ROUGHNESS, SKIN_SPECULAR
from samira_warp.head.regions import REGIONS, route_faces
from samira_warp.head.template import HeadTemplate
from samira_warp.train.neighbours import Neighbourhood


class Finish(NamedTuple):
    """Roughness, perceptual, and reflectance at normal incidence."""

    roughness: float
    specular: float


SKIN = Finish(SKIN_ROUGHNESS, SKIN_SPECULAR)
WET_MOUTH = Finish(0.25, 0.03)
CORNEA = Finish(0.1, 0.025)

EYEBALLS = ("left_eyeball", "right_eyeball")
"""Masks of what has a cornea's finish and the head model's own normals, and keeps them."""

ROUGHNESS_UNIT = 0.2
SPECULAR_UNIT = 0.02
"""What counts as one: the spread between people and places in the measurements."""


class MaterialPrior(NamedTuple):
    """What is known of every face's surface.

    Attributes:
        roughness: (F,).
        specular: (F,).
        held: (F,) bool: what is known there is not learned.
    """

    roughness: Tensor
    specular: Tensor
    held: Tensor


def material_prior(template: HeadTemplate) -> MaterialPrior:
    """What is known of a head's surface, by its template's masks; on the CPU."""
    regions = route_faces(template)
    finish = np.tile(np.array(SKIN), (len(template.faces), 1))
    finish[regions == REGIONS.index("mouth")] = WET_MOUTH
    eyeball = np.zeros(len(template.v_template), dtype=bool)
    for name in EYEBALLS:
        eyeball[template.masks.get(name, [])] = True
    held = eyeball[template.faces].all(axis=1)
    finish[held] = CORNEA
    roughness, specular = torch.from_numpy(finish.astype(np.float32)).unbind(dim=1)
    return MaterialPrior(roughness, specular, torch.from_numpy(held))


def material_terms(
    gaussians: Gaussians, prior: MaterialPrior, neighbours: Neighbourhood
) -> tuple[Tensor, Tensor]:
    """Mean square of what roughness and reflectance differ by from what is known, and from their neighbours.

    Both in ROUGHNESS_UNIT and SPECULAR_UNIT.
    """
    faces = gaussians.faces.long()
    known = torch.stack([prior.roughness[faces], prior.specular[faces]], dim=1)
    found = torch.stack([gaussians.roughness, gaussians.specular], dim=1)
    off = (found - known) / found.new_tensor([ROUGHNESS_UNIT, SPECULAR_UNIT])
    return off.square().mean(), neighbours.contrast(off).square().mean()


def hold_known(gaussians: Gaussians, held: Tensor) -> None:
    """Clear the gradients of what is known and not learned, after a backward pass.

    Args:
        gaussians: The avatar's.
        held: (F,) bool, faces whose normals, roughness and reflectance are known.
    """
    there = held[gaussians.faces.long()]
    for parameter in (gaussians.normals, gaussians.roughness_logits, gaussians.specular_logits):
        if parameter.grad is not None:
            parameter.grad[there] = 0.0
