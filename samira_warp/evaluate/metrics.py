"""Scores of one image against the truth, in display values 0..1."""

from __future__ import annotations

import kornia
import torch
from torch import Tensor

PSNR_CAP = 100.0
"""Decibels reported for images that are equal: JSON has no infinity, and a mean over frames needs a
number."""

FOREGROUND = 0.5
"""Pixels with more coverage than this are the head's."""


def psnr(prediction: Tensor, truth: Tensor) -> Tensor:
    """Peak signal-to-noise ratio over all pixels and channels, in dB for a range of 1, at most PSNR_CAP.

    Args:
        prediction: (..., C) floats in 0..1.
        truth: Floats of the same shape.
    """
    return _decibels((prediction - truth).square().mean())


def psnr_where(prediction: Tensor, truth: Tensor, where: Tensor) -> Tensor:
    """PSNR over the pixels (H, W) that ``where`` is true for; NaN where there is none."""
    return psnr(prediction[where], truth[where])


def psnr_gain(prediction: Tensor, truth: Tensor, mask: Tensor) -> Tensor:
    """PSNR over the foreground after the best gain per channel.

    It is what remains once exposure and white balance are forgiven. The gain g of a channel minimises the sum
    over the foreground of (g x prediction - truth)^2, in display values.

    Args:
        prediction: (H, W, 3) floats.
        truth: (H, W, 3) floats.
        mask: (H, W) coverage; the gain is fitted and the score taken where it is above FOREGROUND.
    """
    inside = mask > FOREGROUND
    ours, theirs = prediction[inside], truth[inside]
    power = ours.square().sum(dim=0)
    gain = torch.where(power > 0, (ours * theirs).sum(dim=0) / power.clamp_min(1e-12), 1.0)
    return psnr(ours * gain, theirs)


def l1(prediction: Tensor, truth: Tensor) -> Tensor:
    """Mean absolute difference over all pixels and channels, times 100 (L1* of the paper's tables)."""
    return 100.0 * (prediction - truth).abs().mean()


def ssim_map(prediction: Tensor, truth: Tensor) -> Tensor:
    """Structural similarity at each pixel: Gaussian window of 11 with sigma 1.5, range 1, borders reflected.

    Args:
        prediction: (H, W, C) floats in 0..1.
        truth: (H, W, C) floats.

    Returns:
        (H, W) mean over the channels; differentiable.
    """
    ours, theirs = (image.permute(2, 0, 1)[None] for image in (prediction, truth))
    return kornia.metrics.ssim(ours, theirs, window_size=11, max_val=1.0)[0].mean(dim=0)


def ssim(prediction: Tensor, truth: Tensor) -> Tensor:
    """Mean of ``ssim_map`` over the whole frame, borders included."""
    return ssim_map(prediction, truth).mean()


def normal_angle_map(prediction: Tensor, truth: Tensor) -> Tensor:
    """(H, W) angle in degrees between normals (H, W, 3), which need not be of unit length.

    From the half-angle's tangent: exact for small angles too, where an arc cosine in float32 is not.
    """
    ours, theirs = (torch.nn.functional.normalize(normals, dim=-1) for normals in (prediction, truth))
    half = torch.atan2((ours - theirs).norm(dim=-1), (ours + theirs).norm(dim=-1))
    return torch.rad2deg(2.0 * half)


def normal_angle(prediction: Tensor, truth: Tensor, mask: Tensor) -> Tensor:
    """Mean angle in degrees between normals (H, W, 3) over the foreground of ``mask`` (H, W)."""
    return normal_angle_map(prediction, truth)[mask > FOREGROUND].mean()


def _decibels(mean_square: Tensor) -> Tensor:
    return -10.0 * torch.log10(mean_square.clamp_min(10.0 ** (-PSNR_CAP / 10.0)))
