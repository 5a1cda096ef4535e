"""The light of a capture, learned with the avatar."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samira_warp.kernels.cubemap.layout import texel_directions
from samira_warp.light.environment import Environment
from samira_warp.light.filtered import FilteredLight
from samira_warp.light.harmonics import harmonics, mean_radiance

_RADIANCE_MIN = 1e-4
"""Least initial radiance: softplus reaches 0 only at minus infinity."""

_HARMONICS_FLOOR = 0.05
"""Least initial radiance of a light that is given in harmonics, as a share of its mean. Nine of them ring
below zero opposite to a lamp, where softplus would be too flat to learn from."""


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
        start = _inverse_softplus(radiance)
        diffuse = None if tied else nn.Parameter(start.expand(6, diffuse_size, diffuse_size, 3).clone())
        self.register_parameter("diffuse", diffuse)
        self.specular = nn.Parameter(start.expand(6, specular_size, specular_size, 3).clone())

    @classmethod
    def from_harmonics(cls, light: Tensor, *, tied: bool = False) -> LearnableLight:
        """Start as a light of spherical harmonics, the same in both maps.

        Args:
            light: (9, 3) coefficients of linear radiance (`samira_warp.light.harmonics`).
            tied: As above.
        """
        mean = mean_radiance(light)
        started = cls(mean, tied=tied)
        with torch.no_grad():
            for parameter in started.parameters():
                directions = texel_directions(parameter.shape[1], device=light.device)
                radiance = harmonics(directions) @ light
                parameter.copy_(_inverse_softplus(radiance.maximum(_HARMONICS_FLOOR * mean)))
        return started

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


def _inverse_softplus(radiance: Tensor) -> Tensor:
    """log(exp(x) - 1) of what is at least _RADIANCE_MIN, so that it neither overflows nor cancels."""
    radiance = radiance.detach().to(torch.float32).clamp(min=_RADIANCE_MIN)
    return radiance + torch.log(-torch.expm1(-radiance))
