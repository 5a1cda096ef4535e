"""What drives a frame, standardised, and how it enters the feature pyramid (Eq. flame_adain)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

STANDARD_DEVIATION_FLOOR = 1e-4
"""Below this a condition did not vary in the training frames: it carries nothing and is set to zero."""

CONDITION_LIMIT = 3.0
"""Deviations; another sequence's conditions are held to these, or to the training frames' own extremes where
those reach farther."""


class Conditions(NamedTuple):
    """The head parameters of one frame or a batch, split as the paper splits them.

    Attributes:
        translation: (..., 3) c_tr.
        expression: (..., E) c_exp.
        pose: (..., 3 J) c_pose: axis-angle radians of the rig's joints, one after the other.
    """

    translation: Tensor
    expression: Tensor
    pose: Tensor


class ConditionStatistics(nn.Module):
    """Mean and standard deviation of the training frames' conditions; constants of the avatar."""

    def __init__(self, *, expression_size: int, pose_size: int) -> None:
        super().__init__()
        for name, size in zip(Conditions._fields, (3, expression_size, pose_size), strict=True):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_scale", torch.ones(size))
            self.register_buffer(f"{name}_limit", torch.full((size,), CONDITION_LIMIT))

    @classmethod
    def of(cls, conditions: Conditions) -> ConditionStatistics:
        """Measure the statistics of the training frames, a batch along one dimension."""
        statistics = cls(expression_size=conditions.expression.shape[1], pose_size=conditions.pose.shape[1])
        for name, values in zip(Conditions._fields, conditions, strict=True):
            deviation = values.std(dim=0, correction=0)
            mean, scale = (
                values.mean(dim=0),
                torch.where(deviation < STANDARD_DEVIATION_FLOOR, 0.0, 1.0 / deviation),
            )
            extreme = ((values - mean) * scale).abs().amax(dim=0)
            setattr(statistics, f"{name}_mean", mean)
            setattr(statistics, f"{name}_scale", scale)
            setattr(statistics, f"{name}_limit", extreme.clamp(min=CONDITION_LIMIT))
        return statistics

    def forward(self, conditions: Conditions) -> Conditions:
        """Standardise and hold to the limits; what was constant in training becomes 0."""
        return Conditions(
            *(
                self._standardise(name, value)
                for name, value in zip(Conditions._fields, conditions, strict=True)
            )
        )

    def _standardise(self, name: str, value: Tensor) -> Tensor:
        limit = getattr(self, f"{name}_limit")
        return ((value - getattr(self, f"{name}_mean")) * getattr(self, f"{name}_scale")).clamp(-limit, limit)


class AdaptiveInstanceNorm(nn.Module):
    """AdaIN: features normalised per channel, then scaled and shifted by a function of a condition."""

    def __init__(self, channels: int, condition_size: int, *, hidden: int = 0) -> None:
        """Make the layer.

        Args:
            channels: C.
            condition_size: D.
            hidden: Units between the condition and what scales and shifts; 0 is an affine map, which starts
                at nothing: no feature depends on a condition yet.
        """
        super().__init__()
        self.affine: nn.Module
        if hidden:
            self.affine = nn.Sequential(
                nn.Linear(condition_size, hidden), nn.SiLU(), nn.Linear(hidden, 2 * channels)
            )
        else:
            self.affine = nn.Linear(condition_size, 2 * channels)
            for parameter in self.affine.parameters():
                nn.init.zeros_(parameter)

    def forward(self, features: Tensor, condition: Tensor) -> Tensor:
        """Apply to (1, C, H, W) features with a (D,) condition."""
        return self.modulate(nn.functional.instance_norm(features), condition)

    def modulate(self, normalised: Tensor, condition: Tensor) -> Tensor:
        """The same of features that are normalised."""
        scale, shift = self.affine(condition).view(2, 1, -1, 1, 1)
        return normalised * (1.0 + scale) + shift
