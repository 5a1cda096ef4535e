"""What shading needs to know of a light: irradiance and prefiltered mips."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from samira_warp.kernels.cubemap.filter import irradiance, prefilter

ROUGHNESS_STEP = 0.125
"""Roughness between one specular mip and the next; the first mip is the unfiltered light. Steps of 0.25 blur
a small sun between two mips to several times what it is at 0.35, and ten times at 0.1, where eyes glint
(``bench light --hdri``)."""

IRRADIANCE_SIZE = 16
"""Texels along a face of the irradiance map: a cosine lobe holds nothing finer."""

_SHRINK = (2, 2, 4, 4, 8, 8, 8, 8)
"""The base's size over that of the filtered mips."""


@dataclass(frozen=True, eq=False)
class FilteredLight:
    """A pure function of the radiance.

    Attributes:
        irradiance: (6, 16, 16, 3) float32, E_d: the cosine-weighted mean radiance about each direction.
        specular: Mips (6, S, S, 3) float32: the radiance itself, then E_s at every ROUGHNESS_STEP up to a
            roughness of 1.
    """

    irradiance: torch.Tensor
    specular: tuple[torch.Tensor, ...]

    @classmethod
    def of(cls, diffuse: torch.Tensor, specular: torch.Tensor) -> FilteredLight:
        """Filter two radiance maps (often one and the same) for diffuse and for specular light;
        differentiable in both.

        Args:
            diffuse: (6, S, S, 3) float32 linear radiance, S even.
            specular: (6, S', S', 3) float32 linear radiance, S' divisible by 16.
        """
        base = specular.shape[1]
        ladder = [(ROUGHNESS_STEP * (k + 1), base // shrink) for k, shrink in enumerate(_SHRINK)]
        return cls(irradiance(diffuse, size=IRRADIANCE_SIZE), prefilter(specular, ladder=ladder))

    def to(self, device: torch.device | str) -> FilteredLight:
        """The same light on ``device``."""
        return FilteredLight(self.irradiance.to(device), tuple(mip.to(device) for mip in self.specular))
