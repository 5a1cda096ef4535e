"""Deferred physically based shading of a G-buffer: Eqs. response_shading and pbr_color."""

from __future__ import annotations

import torch

from samira_warp.kernels.deferred_shading import Shaded, shade_gbuffer
from samira_warp.light.brdf import brdf_table
from samira_warp.light.filtered import FilteredLight
from samira_warp.validation import check_tensor


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
        normal: (M, 3) unit normals in world space; a point with a zero normal sees no light and gets no gradient.
        roughness: (M, 1), clamped to 0 to 1.
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
    device = light.irradiance.device
    surface = {
        "albedo": albedo,
        "normal": normal,
        "roughness": roughness,
        "specular": specular,
        "response_diffuse": response_diffuse,
        "response_specular": response_specular,
        "view": view,
    }
    for name, values in surface.items():
        check_tensor(name, values, shape=(albedo.shape[0], 3 if name in ("albedo", "normal", "view") else 1), device=device)
    return shade_gbuffer(**surface, irradiance=light.irradiance, mips=light.specular, brdf=brdf_table(device))
