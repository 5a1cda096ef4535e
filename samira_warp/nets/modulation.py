"""Semantic-adaptive residual modulation over disjoint UV masks: Eqs. region_modulation, region_feature."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class RegionModulators(nn.Module):
    """One small modulator phi_k a region, as grouped convolutions, and the smoothing block eta.

    phi_k is a linear 1x1 projection, a 3x3 convolution, an activation and a 1x1 convolution, with one group a
    region. The projection has no bias, so projecting and then masking equals masking and then projecting, F *
    S_k, without a copy of the input for every region.
    """

    masks: Tensor

    def __init__(self, in_channels: int, channels: int, *, masks: Tensor, shared: bool = False) -> None:
        """Make the modulators.

        Args:
            in_channels: Channels of [F_sh, F_d].
            channels: Channels of each F_k.
            masks: (K, H, W) disjoint masks S_k of 0 and 1.
            shared: One modulator for all regions, masks kept (the paper's ablation of semantic-adaptive
                modulation).
        """
        super().__init__()
        self.regions = masks.shape[0]
        groups = 1 if shared else self.regions
        self.shared = shared
        self.register_buffer("masks", masks[None, :, None], persistent=False)
        self.project = nn.Conv2d(in_channels, groups * channels, 1, bias=False)
        self.mix = nn.Conv2d(groups * channels, groups * channels, 3, padding=1, groups=groups)
        self.out = nn.Conv2d(groups * channels, groups * channels, 1, groups=groups)
        self.smooth = nn.Conv2d(channels, channels, 3, padding=1, groups=channels, bias=False)
        self.blend = nn.Conv2d(channels, channels, 1)
        _start_as_binomial(self.smooth)

    def forward(self, features: Tensor) -> Tensor:
        """F_sem (1, C, H, W) of [F_sh, F_d] (1, C_in, H, W)."""
        height, width = features.shape[-2:]
        projected = self.project(features).view(
            1, -1, self.mix.out_channels // self.mix.groups, height, width
        )
        masked = projected * self.masks
        if self.shared:
            modulated = self.out(nn.functional.silu(self.mix(masked[0])))[None]
        else:
            modulated = self.out(nn.functional.silu(self.mix(masked.flatten(1, 2)))).view_as(masked)
        return nn.functional.silu(self.blend(self.smooth((modulated * self.masks).sum(dim=1))))


def _start_as_binomial(convolution: nn.Conv2d) -> None:
    """Start a depthwise 3x3 convolution as the binomial low-pass, which is what smooths mask boundaries."""
    row = torch.tensor([0.25, 0.5, 0.25])
    with torch.no_grad():
        convolution.weight.copy_(torch.outer(row, row).expand_as(convolution.weight))
