"""Semantic illumination response: compact factors per region, spread over the UV domain.

Eqs. region_response and uv_response_map.
"""

from __future__ import annotations

import torch
from torch import Tensor

COVERAGE_EPSILON = 1e-6
"""The small constant of Eq. uv_response_map; it keeps the division finite where no mask reaches."""


def response_factors(logits: Tensor) -> Tensor:
    """tau_k = 0.5 + sigmoid(l_k), (K, 2) diffuse and specular, each in 0.5..1.5.

    Logits of zero are neutral.
    """
    return 0.5 + torch.sigmoid(logits)


def response_map(factors: Tensor, soft_masks: Tensor) -> Tensor:
    """The dense response map T^uv.

    The weighted mean is written as 1 + sum S_k (tau_k - 1) / (sum S_k + epsilon): the paper's ratio but for
    its epsilon, which then pulls towards neutral instead of towards zero, so a texel that no mask covers is
    exactly neutral without a rule of its own.

    Args:
        factors: (K, 2) tau_k.
        soft_masks: (K, H, W) masks S_k, at least 0; they may overlap.

    Returns:
        (H, W, 2) diffuse and specular factors.
    """
    weights = soft_masks / (soft_masks.sum(dim=0) + COVERAGE_EPSILON)
    return 1.0 + torch.einsum("khw,kc->hwc", weights, factors - 1.0)
