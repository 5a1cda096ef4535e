"""Deferred shading in plain torch, for any floating dtype: the specification of `light.shading.shade`."""

from __future__ import annotations

import torch

from samira_warp.light.brdf import lookup_brdf
from samira_warp.reference.cubemap import sample_cubemap, sample_mips


def shade(
    albedo: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    specular: torch.Tensor,
    response_diffuse: torch.Tensor,
    response_specular: torch.Tensor,
    view: torch.Tensor,
    irradiance_map: torch.Tensor,
    mips: tuple[torch.Tensor, ...],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Eqs. response_shading and pbr_color: color, irradiance, specular_light and specular_color, each (M, 3); see `light.shading.shade`."""
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = 2 * cosine * normal - view
    irradiance = response_diffuse * sample_cubemap(irradiance_map, normal)
    specular_light = response_specular * sample_mips(mips, reflected, roughness[:, 0] * (len(mips) - 1))
    scale, bias = lookup_brdf(roughness[:, 0], cosine[:, 0])
    specular_color = specular_light * (specular * scale[:, None] + bias[:, None])
    return albedo * (1 - specular) * irradiance + specular_color, irradiance, specular_light, specular_color
