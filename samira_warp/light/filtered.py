"""What shading needs to know of a light: irradiance and prefiltered mips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.filter import irradiance, prefilter
from samira_warp.kernels.cubemap.layout import texel_solid_angles
from samira_warp.light.bright_spots import BrightSpots, divide
from samira_warp.light.equirect import check_degrees
from samira_warp.support.errors import UserError
from samira_warp.support.exposure import check_exposure

ROUGHNESS_STEP = 0.125
"""Roughness between one specular mip and the next; the first mip is the unfiltered light. Steps of 0.25 blur
a small sun between two mips to several times what it is at 0.35, and ten times at 0.1, where eyes glint
(``bench light --hdri``)."""

IRRADIANCE_SIZE = 16
"""Texels along a face of the irradiance map: a cosine lobe holds nothing finer."""

SHADOW_SIZE = 16
"""Texels along a face of the radiance that shadows are summed of: finer than the directions of
`samira_warp.avatar.occlusion`."""

SPOT_SIZE = 64
"""Texels along a face in which bright parts are looked for: a degree and a half."""

_SHRINK = (2, 2, 4, 4, 8, 8, 8, 8)
"""The base's size over that of the filtered mips."""


@dataclass(frozen=True, eq=False)
class FilteredLight:
    """A light as shading reads it: filtered once, then turned and exposed at no cost.

    The maps are pure functions of the radiance as it was read.

    Attributes:
        irradiance: (6, 16, 16, 3) float32, E_d: the cosine-weighted mean radiance about each direction.
        specular: Mips (6, S, S, 3) float32: the radiance itself, then E_s at every ROUGHNESS_STEP up to a
            roughness of 1.
        radiance: (6, 16, 16, 3) float32: the radiance that diffuse surfaces see, for cast shadows; without
            ``spots``.
        rotate: Degrees by which the light is turned about the vertical, as `Environment.rotate`.
        exposure: Factor on its radiance.
        spots: Bright parts of it that cast shadows with edges, or None.
    """

    irradiance: Tensor
    specular: tuple[Tensor, ...]
    radiance: Tensor
    rotate: float = 0.0
    exposure: float = 1.0
    spots: BrightSpots | None = None

    @classmethod
    def of(cls, diffuse: Tensor, specular: Tensor) -> FilteredLight:
        """Filter two radiance maps (often one and the same) for diffuse and for specular light.

        Differentiable in both.

        Args:
            diffuse: (6, S, S, 3) float32 linear radiance, S even.
            specular: (6, S', S', 3) float32 linear radiance, S' divisible by 16.
        """
        base = specular.shape[1]
        ladder = [(ROUGHNESS_STEP * (k + 1), base // shrink) for k, shrink in enumerate(_SHRINK)]
        filtered = irradiance(diffuse, size=IRRADIANCE_SIZE), prefilter(specular, ladder=ladder)
        return cls(*filtered, _shrink(diffuse, size=SHADOW_SIZE))

    def with_spots(self, diffuse: Tensor) -> FilteredLight:
        """The same light with the bright parts of its diffuse map apart, for shadows with edges.

        Args:
            diffuse: The map that it was filtered of.
        """
        divided = divide(_shrink(diffuse, size=SPOT_SIZE))
        return replace(self, radiance=_shrink(divided.rest, size=SHADOW_SIZE), spots=divided.spots)

    def to(self, device: torch.device | str) -> FilteredLight:
        """The same light on ``device``."""
        moved = tuple(mip.to(device) for mip in self.specular)
        irradiance, radiance = self.irradiance.to(device), self.radiance.to(device)
        spots = None if self.spots is None else self.spots.to(device)
        return replace(self, irradiance=irradiance, specular=moved, radiance=radiance, spots=spots)

    def turned(self, degrees: float) -> FilteredLight:
        """The same light turned by so many degrees more.

        Raises:
            UserError: They are not finite.
        """
        check_degrees(degrees)
        return replace(self, rotate=self.rotate + degrees)

    def exposed(self, factor: float) -> FilteredLight:
        """The same light times a factor.

        Raises:
            UserError: It is not a finite number of at least 0; what ``auto`` is, `Environment.exposed` says.
        """
        if factor == "auto":
            raise UserError("exposure", expected="a factor, once a light is filtered", found=factor)
        check_exposure(factor)
        return replace(self, exposure=self.exposure * factor)


def _shrink(cubemap: Tensor, *, size: int) -> Tensor:
    """The map with faces of ``size`` texels at most: means by solid angle of k x k texels each.

    A map whose faces cannot be divided so keeps the least number of texels above it that they can.
    """
    own = cubemap.shape[1]
    factor = next(k for k in range(max(own // size, 1), 0, -1) if own % k == 0)
    if factor == 1:
        return cubemap
    areas = texel_solid_angles(own, device=cubemap.device)[None, :, :, None]

    def sums(texels: Tensor) -> Tensor:
        return texels.unflatten(2, (-1, factor)).unflatten(1, (-1, factor)).sum(dim=(2, 4))

    return sums(areas * cubemap) / sums(areas)
