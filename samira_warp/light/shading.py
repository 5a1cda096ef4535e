"""Deferred physically based shading of a G-buffer: Eqs. response_shading and pbr_color."""

from __future__ import annotations

from typing import NamedTuple

import torch

from samira_warp.kernels.cubemap_lookup import sample_cubemap, sample_mips
from samira_warp.light.brdf import lookup_brdf
from samira_warp.light.filtered import ROUGHNESS_STEP, FilteredLight
from samira_warp.validation import check_tensor


class Shaded(NamedTuple):
    """A shaded surface, M points, linear radiance.

    Attributes:
        color: (M, 3) C_fg of Eq. pbr_color.
        irradiance: (M, 3) L_d = tau_d E_d(n).
        specular_light: (M, 3) L_s = tau_s E_s(n, v, rho), before the BRDF.
        specular_color: (M, 3) L_s (f B_x + B_y), the specular part of ``color``.
    """

    color: torch.Tensor
    irradiance: torch.Tensor
    specular_light: torch.Tensor
    specular_color: torch.Tensor


def shade(
    albedo: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    specular: torch.Tensor,
    response_diffuse: torch.Tensor,
    response_specular: torch.Tensor,
    view: torch.Tensor,
    light: FilteredLight,
) -> Shaded:
    """Shade M points of a G-buffer: L_d = tau_d E_d(n), L_s = tau_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d + L_s (f B_x + B_y).

    Args:
        albedo: (M, 3) float32, linear, 0 to 1.
        normal: (M, 3) unit normals in world space; a zero normal sees no light.
        roughness: (M, 1), 0 to 1.
        specular: (M, 1) reflectance f at normal incidence.
        response_diffuse: (M, 1) tau_d.
        response_specular: (M, 1) tau_s.
        view: (M, 3) unit directions from the point to the camera.
        light: The filtered light, on the same device.

    Returns:
        Colours, differentiable in every argument, the light's maps included.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    count, device = albedo.shape[0], light.irradiance.device
    for name, tensor, channels in (
        ("albedo", albedo, 3),
        ("normal", normal, 3),
        ("roughness", roughness, 1),
        ("specular", specular, 1),
        ("response_diffuse", response_diffuse, 1),
        ("response_specular", response_specular, 1),
        ("view", view, 3),
    ):
        check_tensor(name, tensor, shape=(count, channels), device=device)
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = 2 * cosine * normal - view * (normal != 0).any(dim=-1, keepdim=True)
    irradiance = response_diffuse * sample_cubemap(light.irradiance, normal)
    specular_light = response_specular * sample_mips(light.specular, reflected, roughness[:, 0] / ROUGHNESS_STEP)
    scale, bias = lookup_brdf(roughness[:, 0], cosine[:, 0])
    specular_color = specular_light * (specular * scale[:, None] + bias[:, None])
    return Shaded(albedo * (1 - specular) * irradiance + specular_color, irradiance, specular_light, specular_color)
