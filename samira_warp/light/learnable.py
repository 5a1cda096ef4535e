"""The light of a capture, learned with the avatar."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samira_warp.light.environment import Environment
from samira_warp.light.filtered import FilteredLight

_RADIANCE_MIN = 1e-4
"""Least initial radiance: softplus reaches 0 only at minus infinity."""


class LearnableLight(nn.Module):
    """Two cubemaps of radiance, for diffuse and for specular light; tied, they are one.

    Softplus keeps them positive, nothing bounds them.

    Attributes:
        diffuse: (6, 16, 16, 3) float32 parameter; its softplus is radiance. None where diffuse surfaces see
            the specular map.
        specular: (6, 64, 64, 3) float32 parameter; its softplus is radiance.
    """

    def __init__(
        self, radiance: Tensor, *, tied: bool = False, diffuse_size: int = 16, specular_size: int = 64
    ) -> None:
        """Start as a uniform light.

        Args:
            radiance: (3,) linear radiance.
            tied: One map for both, as a real light has; irradiance is then filtered from the specular map.
            diffuse_size: Even size of the diffuse map.
            specular_size: Size of the specular map, divisible by 16.
        """
        super().__init__()
        self.diffuse: nn.Parameter | None
        # Inverse of softplus: log(exp(x) - 1), written so that it neither overflows nor cancels.
        radiance = radiance.detach().to(torch.float32).clamp(min=_RADIANCE_MIN)
        start = radiance + torch.log(-torch.expm1(-radiance))
        diffuse = None if tied else nn.Parameter(start.expand(6, diffuse_size, diffuse_size, 3).clone())
        self.register_parameter("diffuse", diffuse)
        self.specular = nn.Parameter(start.expand(6, specular_size, specular_size, 3).clone())

    def radiance(self) -> tuple[Tensor, Tensor]:
        """The diffuse and the specular map, (6, S, S, 3) linear radiance; one and the same where tied."""
        specular = nn.functional.softplus(self.specular)
        return specular if self.diffuse is None else nn.functional.softplus(self.diffuse), specular

    def forward(self) -> FilteredLight:
        """Filter the maps as they are now."""
        return FilteredLight.of(*self.radiance())

    def environment(self) -> Environment:
        """The light as it is now, detached, to render with."""
        diffuse, specular = self.radiance()
        return Environment.from_cubemaps(diffuse.detach(), specular.detach())
