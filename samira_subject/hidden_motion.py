"""Motion that the built-in subject's template has no shapes for: a known function of pose and expression.

Nothing of it is in the tracks: whoever models the head from them has to learn it from the pictures, even what
shapes of the template could make together. A cheek bulges when it smiles, lips press thinner than their
shapes make them, the fold of an eyelid sinks when it closes, hair and collar give way when the head tilts or
nods. They do not when it turns from side to side: what goes sideways in proportion to the yaw looks to one
camera as if it lay deeper and did not move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import coo_array, diags_array
from torch import Tensor

from samira_subject.performance import PITCH, ROLL
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head import FrameParameters, HeadTemplate, PosedHead

SOFTENED = 12
"""Rounds in which every vertex takes the mean of itself and its neighbours, so that nothing tears at the edge
of a mask."""

CHEEK_BULGE, CHEEK_RADIUS = 0.02, 0.015
"""Metres: outward at a full smile, before it is softened to a third of that, and how far about its middle."""

CHEEK_PLACE = np.array([0.042, -0.012, -0.03])
"""Metres from the middle of the nose to that of the left cheek."""

LIPS_THINNER, LIPS_INWARD = 0.6, 3e-3
"""Share of their height that pressed lips lose, and metres that they go in."""

FOLD_SINKS, FOLD_RADIUS, FOLD_ABOVE = 3e-3, 0.008, 0.013
"""Metres down that the fold of a closing lid sinks, about how wide, and how far above the eye's middle."""

HAIR_GIVES, HAIR_HEIGHT = 8e-3, 0.06
"""Metres at the crown at the farthest tilt or nod, and the height over which this rises from nothing."""

COLLAR_GIVES, COLLAR_HEIGHT = 6e-3, 0.05
"""Metres at the neck's end at the farthest tilt or nod, and the height over which this falls to nothing."""

STILL = (0.0, 0.0, 0.0)
"""Weights of the head's pitch, yaw and roll for what does not come with them."""

SMILE, PRESS, BLINK = "mouthSmile", "mouthPress", "eyeBlink"
"""The shapes, one a side, that it comes with."""


@dataclass(frozen=True, eq=False)
class HiddenMotion:
    """What moves, and with what.

    Attributes:
        parts: What it is called, one name a direction.
        directions: (P, V, 3) float32 displacement at a strength of 1, metres, in the axes of the head.
        expression: (P, E) float32 weights whose product with an expression, squared, is a strength: it comes
            late and then fast, as no linear shape does.
        turn: (P, 3) float32 weights of the head's pitch, yaw and roll in radians, whose sum is added to it.
    """

    parts: tuple[str, ...]
    directions: Tensor
    expression: Tensor
    turn: Tensor

    def strengths(self, parameters: FrameParameters) -> Tensor:
        """(P,) how far each part goes in a frame."""
        turned = parameters.rotations[0] + parameters.rotations[1]
        return (self.expression @ parameters.expression).square() + self.turn @ turned

    def displacement(self, parameters: FrameParameters) -> Tensor:
        """(V, 3) metres, in the axes of the head."""
        return torch.einsum("p,pvc->vc", self.strengths(parameters), self.directions)

    def in_world(self, parameters: FrameParameters, posed: PosedHead) -> Tensor:
        """(V, 3) metres, along the axes of the world that the head is posed in."""
        return self.displacement(parameters) @ posed.head_transform[:3, :3].T


def hidden_motion(template: HeadTemplate) -> HiddenMotion:
    """The hidden motion of a head whose template is the built-in one."""
    rest = template.v_template.astype(np.float64)
    normals = vertex_normals(torch.from_numpy(rest), torch.from_numpy(template.faces)).numpy()
    names = template.expression_names
    soften = _softener(template)
    parts: dict[str, tuple[np.ndarray, dict[str, float], tuple[float, float, float]]] = {}
    for side, sign in (("L", 1.0), ("R", -1.0)):
        parts[f"cheek_{side}"] = (_cheek(template, rest, normals, sign), {f"{SMILE}_{side}": 1.0}, STILL)
        parts[f"fold_{side}"] = (_fold(template, rest, side), {f"{BLINK}_{side}": 1.0}, STILL)
    both = {f"{PRESS}_L": 0.5, f"{PRESS}_R": 0.5}
    parts["lips"] = (_lips(template, rest), both, STILL)
    for name, weight, amount in (
        ("hair", _hair(template, rest), HAIR_GIVES),
        ("collar", _collar(template, rest), COLLAR_GIVES),
    ):
        # to the side that the head tilts to, and up when it nods
        parts[f"{name}_sideways"] = (-amount * weight * _axis(0), {}, (0.0, 0.0, 1.0 / ROLL))
        parts[f"{name}_upward"] = (amount * weight * _axis(1), {}, (1.0 / PITCH, 0.0, 0.0))
    weights = np.zeros((len(parts), len(names)))
    for part, (_, shapes, _) in enumerate(parts.values()):
        for shape, value in shapes.items():
            weights[part, names.index(shape)] = value
    return HiddenMotion(
        tuple(parts),
        torch.from_numpy(np.stack([soften(direction) for direction, _, _ in parts.values()])).float(),
        torch.from_numpy(weights).float(),
        torch.tensor([turn for _, _, turn in parts.values()]).float(),
    )


def _cheek(template: HeadTemplate, rest: np.ndarray, normals: np.ndarray, sign: float) -> np.ndarray:
    """(V, 3) out of the face about the middle of a cheek; ``sign`` is +1 on the subject's left."""
    middle = rest[template.masks["nose"]].mean(axis=0) + CHEEK_PLACE * [sign, 1.0, 1.0]
    on_face = _mask(template, "face") & ~_mask(template, "mouth") & ~_mask(template, "teeth")
    return CHEEK_BULGE * (_bell(rest - middle, CHEEK_RADIUS) * on_face)[:, None] * normals


def _fold(template: HeadTemplate, rest: np.ndarray, side: str) -> np.ndarray:
    """(V, 3) down, about a line above an eye."""
    name = {"L": "left", "R": "right"}[side]
    middle = rest[template.masks[f"{name}_eyeball"]].mean(axis=0) + FOLD_ABOVE * _axis(1)
    away = (rest - middle) * [0.5, 1.0, 0.0]
    lid = _mask(template, f"{name}_eye_region") & ~_mask(template, f"{name}_eyeball")
    return -FOLD_SINKS * (_bell(away, FOLD_RADIUS) * lid)[:, None] * _axis(1)


def _lips(template: HeadTemplate, rest: np.ndarray) -> np.ndarray:
    """(V, 3) towards the line of the mouth and into it."""
    lips = template.masks["lips"]
    line = rest[lips, 1].mean()
    half = np.abs(rest[lips, 1] - line).max()
    across = np.clip((rest[:, 1] - line) / half, -1.0, 1.0)
    wide = 1.0 - np.clip(rest[:, 0] / np.abs(rest[lips, 0]).max(), -1.0, 1.0) ** 2
    # from nothing at the line over the most between to nothing at the edge of the lips
    inward = (1.0 - across**2) * wide
    towards = -LIPS_THINNER * half * 2.6 * across * inward
    return (
        np.stack([np.zeros(len(rest)), towards, -LIPS_INWARD * inward], axis=1)
        * _mask(template, "lips")[:, None]
    )


def _hair(template: HeadTemplate, rest: np.ndarray) -> np.ndarray:
    """(V, 1) share that rises from the edge of the scalp to the crown."""
    height = rest[:, 1] - (rest[template.masks["scalp"], 1].max() - 2.0 * HAIR_HEIGHT)
    return (_mask(template, "scalp") * np.clip(height / HAIR_HEIGHT, 0.0, 1.0))[:, None]


def _collar(template: HeadTemplate, rest: np.ndarray) -> np.ndarray:
    """(V, 1) share that falls from the neck's end upwards."""
    neck = _mask(template, "neck") | _mask(template, "boundary")
    height = rest[:, 1] - rest[neck, 1].min()
    return (neck * np.clip(1.0 - height / COLLAR_HEIGHT, 0.0, 1.0))[:, None]


def _softener(template: HeadTemplate) -> Callable[[np.ndarray], np.ndarray]:
    """Takes (V, 3) to what is left of it after SOFTENED rounds."""
    count, faces = len(template.v_template), template.faces
    starts, ends = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    pairs = (np.concatenate([starts, ends]), np.concatenate([ends, starts]))
    adjacent = coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count)).tocsr()
    adjacent.data[:] = 1.0
    mean = diags_array(1.0 / (adjacent.sum(axis=1) + 1.0)) @ (adjacent + diags_array(np.ones(count)))

    def soften(values: np.ndarray) -> np.ndarray:
        for _ in range(SOFTENED):
            values = mean @ values
        return values

    return soften


def _mask(template: HeadTemplate, name: str) -> np.ndarray:
    """(V,) bool."""
    inside = np.zeros(len(template.v_template), dtype=bool)
    inside[template.masks[name]] = True
    return inside


def _bell(away: np.ndarray, radius: float) -> np.ndarray:
    """(V,) from 1 at no distance (V, 3) smoothly to 0 at twice the radius."""
    share = np.clip(1.0 - np.square(away).sum(axis=1) / (4.0 * radius**2), 0.0, 1.0)
    return share**2


def _axis(index: int) -> np.ndarray:
    """(3,) unit vector."""
    return np.eye(3)[index]
