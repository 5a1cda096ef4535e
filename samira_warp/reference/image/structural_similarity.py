"""Structural similarity by a matrix a direction."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.image.structural_similarity import CONTRAST, LUMINANCE, RADIUS, window


def structural_similarity(prediction: Tensor, truth: Tensor) -> Tensor:
    """Mean similarity of two (H, W, C) pictures."""
    down, across = (_blur(size, prediction) for size in prediction.shape[:2])

    def mean(values: Tensor) -> Tensor:
        return torch.einsum("cw,rwk->rck", across, torch.einsum("rh,hwk->rwk", down, values))

    x, y = mean(prediction), mean(truth)
    variances = mean(prediction**2) - x**2 + mean(truth**2) - y**2
    covariance = mean(prediction * truth) - x * y
    luminance = (2 * x * y + LUMINANCE) / (x**2 + y**2 + LUMINANCE)
    return (luminance * (2 * covariance + CONTRAST) / (variances + CONTRAST)).mean()


def _blur(count: int, like: Tensor) -> Tensor:
    """(count, count) weights of every row's window, what is beyond a border reflected."""
    matrix = like.new_zeros(count, count)
    for row in range(count):
        for step, weight in zip(range(-RADIUS, RADIUS + 1), window(), strict=True):
            source = abs(row + step)
            matrix[row, min(source, 2 * (count - 1) - source)] += weight.to(like)
    return matrix
