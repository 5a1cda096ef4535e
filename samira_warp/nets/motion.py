"""The semantic-adaptive motion network.

UV displacement, reference appearance and head parameters go in, a UV residual map comes out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from samira_warp.nets.conditioning import AdaptiveInstanceNorm, Conditions
from samira_warp.nets.fourier import fourier_channels, fourier_features
from samira_warp.nets.modulation import RegionModulators
from samira_warp.nets.resizing import resize
from samira_warp.support.unchanged import WhileUnchanged

RESIDUAL_CHANNELS = 6
"""Three of position o_mu and three of rotation o_r (Eq. offset_sample)."""

SLOPE_CHANNELS = 2
"""Of wrinkles, along u and v; beyond the paper."""


@dataclass(frozen=True)
class MotionSettings:
    """Sizes and variants of the motion network.

    Attributes:
        width: Channels of the shared feature F_sh and of F_pos and F_d.
        region_width: Channels of each region's feature F_k.
        condition_width: Hidden units between a condition and its AdaIN's scales and shifts; 0 is an affine
            map. A perceptron of 64, which older avatars have, learned training frames by heart
            (docs/measurements.md).
        bands: Octaves of the positions' Fourier mapping.
        displacement_bands: Octaves of the displacement's. It tells frames apart, not places: in six octaves,
            some hundred radians for a centimetre, neighbouring frames look unlike each other, and the network
            learns them by heart (docs/measurements.md).
        routing: Regions have masks of their own; False is one mask of ones and one modulator.
        modulation: Regions have modulators of their own; False is one modulator behind all masks.
        displacement: The displacement map is seen; False sets F_d to zero.
        wrinkles: Slopes of the normals are given beside the residual.
    """

    width: int = 64
    region_width: int = 32
    condition_width: int = 0
    bands: int = 6
    displacement_bands: int = 1
    routing: bool = True
    modulation: bool = True
    displacement: bool = True
    wrinkles: bool = False


class MotionNetwork(nn.Module):
    """Eqs. uv_geom_feat to dynamic_map.

    The last layers start at zero, so residual and slopes start at exactly zero.
    """

    reference: Tensor

    def __init__(
        self,
        settings: MotionSettings,
        *,
        reference_positions: Tensor,
        image_features: list[Tensor],
        masks: Tensor,
        expression_size: int,
        pose_size: int,
    ) -> None:
        """Make the network for one avatar.

        Args:
            settings: Sizes and variants.
            reference_positions: (3, H, W) P_ref scaled to [-1, 1].
            image_features: L = 3 maps {F_l^img}, each (1, C_l, H_l, W_l), finest first.
            masks: (K, H, W) disjoint routing masks.
            expression_size: E.
            pose_size: Length of c_pose.
        """
        super().__init__()
        self.settings = settings
        self._kept: WhileUnchanged[_Unconditioned] = WhileUnchanged()
        width = settings.width
        self.register_buffer(
            "reference", fourier_features(reference_positions[None], bands=settings.bands), persistent=False
        )
        for level, features in enumerate(image_features):
            self.register_buffer(f"image_features_{level}", features)
        channels = fourier_channels(3, bands=settings.bands)
        self.position = nn.Sequential(nn.Conv2d(channels, width, 1), nn.SiLU(), nn.Conv2d(width, width, 1))
        displacement_channels = fourier_channels(3, bands=settings.displacement_bands)
        self.displacement = nn.Sequential(
            nn.Conv2d(displacement_channels, width, 1), nn.SiLU(), nn.Conv2d(width, width, 1)
        )
        # without bias: the instance normalisation that follows would remove it
        self.lateral = nn.ModuleList(
            nn.Conv2d(features.shape[1], width, 1, bias=False) for features in image_features
        )
        self.gates = nn.Parameter(torch.zeros(len(image_features)))
        condition_sizes = (3, expression_size, pose_size)
        self.adain = nn.ModuleList(
            AdaptiveInstanceNorm(width, size, hidden=settings.condition_width) for size in condition_sizes
        )
        self.fuse = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in image_features)
        self.shared = nn.Conv2d(2 * width, width, 3, padding=1)
        routes = masks if settings.routing else torch.ones_like(masks[:1])
        self.modulators = RegionModulators(
            2 * width, settings.region_width, masks=routes, shared=not settings.modulation
        )
        self.decode = nn.Conv2d(settings.region_width + width, width, 3, padding=1)
        self.residual = nn.Conv2d(width, RESIDUAL_CHANNELS, 1)
        self.slopes = nn.Conv2d(width, SLOPE_CHANNELS, 1) if settings.wrinkles else None
        for last in filter(None, (self.residual, self.slopes)):
            for parameter in last.parameters():
                nn.init.zeros_(parameter)

    def forward(self, displacement: Tensor, conditions: Conditions) -> Tensor:
        """The UV residual map A_uv of one frame.

        Args:
            displacement: (3, H, W) D_uv in units of 0.01 m.
            conditions: The frame's standardised conditions.

        Returns:
            (6, H, W) residuals before their limits: o_mu, then o_r; (8, H, W) with wrinkles, slopes last.
        """
        known = self._unconditioned()
        position = self.position(self.reference) if known is None else known.position
        shared = self._shared_feature(position, known, conditions)
        if self.settings.displacement:
            mapped = fourier_features(displacement[None], bands=self.settings.displacement_bands)
            displaced = self.displacement(mapped)
        else:
            displaced = torch.zeros_like(position)
        semantic = self.modulators(torch.cat([shared, displaced], dim=1))
        decoded = nn.functional.silu(self.decode(torch.cat([semantic, shared], dim=1)))
        residual = self.residual(decoded)[0]
        return residual if self.slopes is None else torch.cat([residual, self.slopes(decoded)[0]])

    def _unconditioned(self) -> _Unconditioned | None:
        """What is the same in all frames, kept while the weights are; None where gradients are asked for."""
        if torch.is_grad_enabled():
            return None
        weights = (weight for part in (self.position, self.lateral) for weight in part.parameters())
        images = (getattr(self, f"image_features_{level}") for level in range(len(self.lateral)))
        return self._kept.get([*weights, *images, self.gates, self.reference], self._condition_nothing)

    def _condition_nothing(self) -> _Unconditioned:
        position = self.position(self.reference)
        levels = range(len(self.lateral))
        return _Unconditioned(position, [self._normalised_level(level, position) for level in levels])

    def _shared_feature(
        self, position: Tensor, known: _Unconditioned | None, conditions: Conditions
    ) -> Tensor:
        """F_sh (Eqs. uv_gate to shared_uv_feature), from coarse to fine.

        Pose conditions the coarse level, expression the middle one, translation the fine one.
        """
        *finer, coarsest = range(len(self.lateral))
        features = self._level_feature(coarsest, position, known, conditions)
        fused = nn.functional.silu(self.fuse[coarsest](features))
        for level in reversed(finer):
            features = self._level_feature(level, position, known, conditions)
            fused = nn.functional.silu(self.fuse[level](features + resize(fused, like=features)))
        return nn.functional.silu(self.shared(torch.cat([resize(fused, like=position), position], dim=1)))

    def _level_feature(
        self, level: int, position: Tensor, known: _Unconditioned | None, conditions: Conditions
    ) -> Tensor:
        """One level of the image's features, with the position let in and the condition applied."""
        adain = self.adain[level]
        assert isinstance(adain, AdaptiveInstanceNorm)
        normalised = self._normalised_level(level, position) if known is None else known.levels[level]
        return adain.modulate(normalised, conditions[level])

    def _normalised_level(self, level: int, position: Tensor) -> Tensor:
        """One level of the image's features, with the position let in, before the condition."""
        image = self.lateral[level](getattr(self, f"image_features_{level}"))
        injected = image + torch.sigmoid(self.gates[level]) * resize(position, like=image)
        return nn.functional.instance_norm(injected)


class _Unconditioned(NamedTuple):
    """What the network makes of the head alone, before a frame's conditions.

    Attributes:
        position: (1, C, H, W) F_pos.
        levels: (1, C, H_l, W_l) each, the image's features with the position let in, normalised.
    """

    position: Tensor
    levels: list[Tensor]
