"""The mesh-bound Gaussians: geometry in their triangle's frame, materials, and places in the UV atlas."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samira_warp.support.constants import ROUGHNESS_MIN

SPECULAR_RANGE = (0.02, 0.15)
"""Reflectance at normal incidence: water is 0.02, skin 0.028 to 0.045, and nothing on a head beyond 0.15 is a
dielectric."""

ROUGHNESS_RANGE = (ROUGHNESS_MIN, 1.0)
"""Eyes glint at the lower end."""

SKIN_ROUGHNESS = 0.3**0.5
"""Of a Beckmann slope of 0.3, as most faces were measured to have (`train.materials`)."""

SKIN_SPECULAR = 0.028
"""Reflectance of an index of refraction of 1.4."""


class Gaussians(nn.Module):
    """N Gaussians bound to faces, as learnable parameters in unconstrained form.

    Attributes:
        means: (N, 3) centres in the triangle's frame, in units of its scale k.
        log_scales: (N, 3) logarithm of the standard deviations in units of k.
        quaternions: (N, 4) w, x, y, z of the rotation in the triangle's frame, any length.
        opacity_logits: (N,).
        albedo_logits: (N, 3) of linear albedo in 0..1.
        roughness_logits: (N,) within ROUGHNESS_RANGE.
        specular_logits: (N,) within SPECULAR_RANGE.
        normals: (N, 3) canonical normals n^c in the triangle's frame, any length.
        initial_normals: (N, 3) unit mesh-frame normals n^m, constant.
        faces: (N,) int32 face of each Gaussian, constant between density control events.
        uv: (N, 2) u_i of Alg. 1 (u right, v up), constant between refreshes.
        guessed: (N,) bool: no picture saw it, and its geometry and opacity are a guess (`train.unseen`).
    """

    means: nn.Parameter
    log_scales: nn.Parameter
    quaternions: nn.Parameter
    opacity_logits: nn.Parameter
    albedo_logits: nn.Parameter
    roughness_logits: nn.Parameter
    specular_logits: nn.Parameter
    normals: nn.Parameter
    initial_normals: Tensor
    faces: Tensor
    uv: Tensor
    guessed: Tensor

    PARAMETERS = (
        "means",
        "log_scales",
        "quaternions",
        "opacity_logits",
        "albedo_logits",
        "roughness_logits",
        "specular_logits",
        "normals",
    )
    CONSTANTS = ("initial_normals", "faces", "uv", "guessed")
    NAMES = (*PARAMETERS, *CONSTANTS)

    def __init__(self, values: dict[str, Tensor]) -> None:
        """Take the tensors named by NAMES."""
        super().__init__()
        for name in self.PARAMETERS:
            self.register_parameter(name, nn.Parameter(values[name].contiguous()))
        for name in self.CONSTANTS:
            self.register_buffer(name, values[name].contiguous())

    def __len__(self) -> int:
        """N."""
        return len(self.means)

    @property
    def scales(self) -> Tensor:
        """(N, 3) standard deviations in units of the triangle's k."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        """(N,) in 0..1."""
        return self.opacity_logits.sigmoid()

    @property
    def albedo(self) -> Tensor:
        """(N, 3) linear, 0..1."""
        return self.albedo_logits.sigmoid()

    @property
    def roughness(self) -> Tensor:
        """(N,) perceptual roughness rho; GGX's alpha is its square."""
        low, high = ROUGHNESS_RANGE
        return low + (high - low) * self.roughness_logits.sigmoid()

    @property
    def specular(self) -> Tensor:
        """(N,) reflectance at normal incidence f."""
        low, high = SPECULAR_RANGE
        return low + (high - low) * self.specular_logits.sigmoid()

    def tensors(self) -> dict[str, Tensor]:
        """Every parameter's and constant's current value, detached, by name."""
        return {name: getattr(self, name).detach() for name in self.NAMES}

    @classmethod
    def start(
        cls,
        *,
        means: Tensor,
        scales: Tensor,
        normals: Tensor,
        albedo: Tensor,
        roughness: Tensor,
        specular: Tensor,
        faces: Tensor,
        uv: Tensor,
        opacity: float,
    ) -> Gaussians:
        """Gaussians of given geometry and materials, with no rotation.

        Args:
            means: (N, 3) in the triangle's frame.
            scales: (N, 3) positive, in units of k.
            normals: (N, 3) unit, in the triangle's frame.
            albedo: (N, 3) linear.
            roughness: (N,) within ROUGHNESS_RANGE.
            specular: (N,) within SPECULAR_RANGE.
            faces: (N,) int32.
            uv: (N, 2).
            opacity: The common initial opacity.
        """
        count = len(means)
        identity = torch.zeros(count, 4, device=means.device)
        identity[:, 0] = 1.0
        return cls(
            {
                "means": means,
                "log_scales": scales.log(),
                "quaternions": identity,
                "opacity_logits": torch.full((count,), _logit(opacity), device=means.device),
                "albedo_logits": torch.logit(albedo.clamp(0.01, 0.99)),
                "roughness_logits": range_logits(roughness, ROUGHNESS_RANGE),
                "specular_logits": range_logits(specular, SPECULAR_RANGE),
                "normals": normals.clone(),
                "initial_normals": normals,
                "faces": faces,
                "uv": uv,
                "guessed": torch.zeros(count, dtype=torch.bool, device=means.device),
            }
        )


def range_logits(values: Tensor, bounds: tuple[float, float]) -> Tensor:
    """What `Gaussians` keeps of values within bounds; at most all but 1 % of the way to either."""
    share = (values - bounds[0]) / (bounds[1] - bounds[0])
    return torch.logit(share.clamp(0.01, 0.99))


def _logit(value: float) -> float:
    return float(torch.logit(torch.tensor(value, dtype=torch.float64)))
