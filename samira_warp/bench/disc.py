"""The rasteriser's synthetic head: Gaussians in a disc, of the sizes and opacities of a trained avatar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera


class RasterInputs(NamedTuple):
    """What `rasterize` takes: see there."""

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    features: Tensor


@dataclass(frozen=True, eq=False)
class Disc:
    """N Gaussians in a disc before a camera behind a long lens.

    Attributes:
        means: (N, 3) metres.
        quaternions: (N, 4) w, x, y, z.
        scales: (N, 3) metres; the third is 0.
        opacities: (N,).
        camera: The view, square.
    """

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    camera: Camera

    def features(self, channels: int) -> Tensor:
        """(N, C) uniform features, the same for a number of channels every time."""
        generator = torch.Generator().manual_seed(channels)
        return torch.rand(len(self.means), channels, generator=generator).to(self.means)

    def raster_inputs(self, channels: int) -> RasterInputs:
        """The Gaussians with C features."""
        return RasterInputs(
            self.means, self.quaternions, self.scales, self.opacities, self.features(channels)
        )

    def image_gradients(self, channels: int) -> tuple[Tensor, Tensor]:
        """Normal (H, W, C) and (H, W): a loss's gradients by the blended features and transmittance."""
        generator = torch.Generator().manual_seed(channels)
        height, width = self.camera.height, self.camera.width
        grad_features = torch.randn(height, width, channels, generator=generator)
        grad_transmittance = torch.randn(height, width, generator=generator)
        return grad_features.to(self.means), grad_transmittance.to(self.means)


def make_disc(count: int, size: int, device: torch.device) -> Disc:
    """Gaussians uniform in a disc of radius 0.42 H, seed 0.

    Their axes are lognormal about 2 px at H = 512 with sigma 0.5, turned anyhow; opacities are 0.05..0.95.
    """
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(6, count, generator=generator)
    angle, radius = 2 * math.pi * uniform[0], 0.42 * size * uniform[1].sqrt()
    # a lens this long sees the same ellipse wherever the Gaussian is
    focal = 50.0 * size
    depths = 1.0 + uniform[2]
    means = torch.stack(
        [radius * angle.cos() * depths / focal, radius * angle.sin() * depths / focal, depths], dim=-1
    )
    pixels = 2.0 * size / 512 * torch.exp(0.5 * torch.randn(count, 2, generator=generator))
    scales = torch.cat([pixels * (depths / focal)[:, None], torch.zeros(count, 1)], dim=-1)
    half_turn = 0.5 * math.pi * uniform[3]
    zero = torch.zeros(count)
    quaternions = torch.stack([half_turn.cos(), zero, zero, half_turn.sin()], dim=-1)
    opacities = 0.05 + 0.9 * uniform[4]
    camera = Camera(torch.eye(4), focal, focal, size / 2, size / 2, size, size)
    return Disc(
        means.to(device), quaternions.to(device), scales.to(device), opacities.to(device), camera.to(device)
    )
