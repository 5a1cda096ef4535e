"""Semantic-adaptive residual modulation over disjoint UV masks: Eqs. region_modulation, region_feature."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from samira_warp.kernels.gathering.gather import GatherTable, gather

TAPS = 9
"""Texels of a 3x3 neighbourhood, row by row."""


class RegionModulators(nn.Module):
    """One small modulator phi_k a region, as grouped convolutions, and the smoothing block eta.

    phi_k is a linear 1x1 projection, a 3x3 convolution, an activation and a 1x1 convolution, with one group a
    region. The projection has no bias, so projecting and then masking equals masking and then projecting, F *
    S_k, without a copy of the input for every region.

    Masks are disjoint, so of all that grouped convolutions make of the whole atlas one region in K is kept at
    each texel. On a CPU, where arithmetic is dear, every texel meets its own region's modulator alone; on a
    GPU, where launches are dear, all regions are convolved at once.
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
        self._order: tuple[Tensor, _TexelOrder] | None = None
        self.project = nn.Conv2d(in_channels, groups * channels, 1, bias=False)
        self.mix = nn.Conv2d(groups * channels, groups * channels, 3, padding=1, groups=groups)
        self.out = nn.Conv2d(groups * channels, groups * channels, 1, groups=groups)
        self.smooth = nn.Conv2d(channels, channels, 3, padding=1, groups=channels, bias=False)
        self.blend = nn.Conv2d(channels, channels, 1)
        _start_as_binomial(self.smooth)

    def forward(self, features: Tensor) -> Tensor:
        """F_sem (1, C, H, W) of [F_sh, F_d] (1, C_in, H, W)."""
        if self.shared:
            modulated = self._with_one(features)
        elif features.device.type == "cpu":
            modulated = self._each_its_own(features)
        else:
            modulated = self._at_once(features)
        return nn.functional.silu(self.blend(self.smooth(modulated)))

    def _with_one(self, features: Tensor) -> Tensor:
        """The sum over regions of F_k, all of one modulator's."""
        masked = self.project(features) * self.masks[0]
        return (self.out(nn.functional.silu(self.mix(masked))) * self.masks[0]).sum(dim=0, keepdim=True)

    def _at_once(self, features: Tensor) -> Tensor:
        """The sum over regions of F_k, by grouped convolutions over the whole atlas."""
        projected = self.project(features).unflatten(1, (self.regions, -1))
        masked = projected * self.masks
        modulated = self.out(nn.functional.silu(self.mix(masked.flatten(1, 2)))).view_as(masked)
        return (modulated * self.masks).sum(dim=1)

    def _each_its_own(self, features: Tensor) -> Tensor:
        """The sum over regions of F_k, every texel by its own region's matrices."""
        order = self._texels_by_region()
        count, channels = self.regions, self.out.out_channels // self.regions
        project = self.project.weight.view(count, channels, -1)
        # patches are tap by tap, a convolution's weights channel by channel
        mix = self.mix.weight.view(count, channels, channels, TAPS).transpose(2, 3).flatten(2)
        mix_bias, out_bias = (part.get_parameter("bias").view(count, -1) for part in (self.mix, self.out))
        out = self.out.weight.view(count, channels, channels)
        texels = gather(features[0].flatten(1).T, order.texels).split(order.counts)
        own = torch.cat([rows @ w.T for rows, w in zip(texels, project, strict=True)])
        around = gather(own, order.neighbours).view(-1, TAPS * channels).split(order.counts)
        mixed = [torch.addmm(b, rows, w.T) for rows, w, b in zip(around, mix, mix_bias, strict=True)]
        active = nn.functional.silu(torch.cat(mixed)).split(order.counts)
        made = [torch.addmm(b, rows, w.T) for rows, w, b in zip(active, out, out_bias, strict=True)]
        whole = gather(torch.cat(made), order.places)
        return whole.T.reshape(1, channels, *features.shape[-2:])

    def _texels_by_region(self) -> _TexelOrder:
        """Found again when the masks have been replaced."""
        if self._order is None or self._order[0] is not self.masks:
            # a tensor of inference mode could never be saved for a backward pass
            with torch.inference_mode(False), torch.no_grad():
                self._order = self.masks, _TexelOrder.of(self.masks[0, :, 0].clone())
        return self._order[1]


class _TexelOrder(NamedTuple):
    """The M texels that lie in a region, region by region.

    Attributes:
        counts: How many each region has.
        texels: From the map's H W texels to these.
        neighbours: From these to the M TAPS around them, itself among them; 0 for one that is not in a
            texel's own region.
        places: From these to the map's texels; 0 for one in no region.
    """

    counts: list[int]
    texels: GatherTable
    neighbours: GatherTable
    places: GatherTable

    @classmethod
    def of(cls, masks: Tensor) -> _TexelOrder:
        """Sort by (K, H, W) disjoint masks."""
        height, width = masks.shape[1:]
        regions = torch.where(masks.any(dim=0), masks.argmax(dim=0), -1)
        texels = torch.cat([(regions == region).flatten().nonzero()[:, 0] for region in range(len(masks))])
        counts = [int((regions == region).sum()) for region in range(len(masks))]
        places = torch.full((height * width,), len(texels), device=masks.device)
        places[texels] = torch.arange(len(texels), device=masks.device)
        # beyond the map's edge no texel is in any region
        known = torch.stack([places.view(height, width), regions])
        edged = torch.nn.functional.pad(known, (1, 1, 1, 1), value=-1)
        around = torch.stack(
            [edged[:, y : y + height, x : x + width] for y in range(3) for x in range(3)], dim=-1
        )
        neighbours = torch.where(around[1] == regions[..., None], around[0], len(texels))
        neighbours = neighbours.flatten(0, 1)[texels].flatten()
        return cls(
            counts,
            _taken(texels, sources=height * width),
            _taken(neighbours, sources=len(texels)),
            _taken(places, sources=len(texels)),
        )


def _taken(places: Tensor, *, sources: int) -> GatherTable:
    """The map that takes the row at each of some places (M,), and zeros beyond the last."""
    there = places < sources
    return GatherTable.build(places.where(there, 0)[:, None], there[:, None].float(), sources=sources)


def _start_as_binomial(convolution: nn.Conv2d) -> None:
    """Start a depthwise 3x3 convolution as the binomial low-pass, which is what smooths mask boundaries."""
    row = torch.tensor([0.25, 0.5, 0.25])
    with torch.no_grad():
        convolution.weight.copy_(torch.outer(row, row).expand_as(convolution.weight))
