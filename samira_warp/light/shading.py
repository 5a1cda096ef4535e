"""Deferred physically based shading of a G-buffer: Eqs. response_shading, pbr_color and alpha_compose."""

from __future__ import annotations

import torch

from samira_warp.kernels.cubemap.layout import check_cubemap
from samira_warp.kernels.shading.deferred import Shaded, shade_gbuffer
from samira_warp.light.brdf import brdf_table
from samira_warp.light.color import ColorSpace
from samira_warp.light.filtered import FilteredLight
from samira_warp.support.validation import check_tensor


def shade(
    albedo: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    specular: torch.Tensor,
    response_diffuse: torch.Tensor,
    response_specular: torch.Tensor,
    view: torch.Tensor,
    light: FilteredLight,
    *,
    alpha: torch.Tensor | None = None,
    background: torch.Tensor | float = 1.0,
    exposure: float = 1.0,
    color_space: ColorSpace = "srgb",
) -> Shaded:
    """Shade M points of a G-buffer and compose them with what is behind.

    L_d = tau_d E_d(n), L_s = tau_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d + L_s (f B_x + B_y), and
    I = alpha encode(C_fg exposure) + (1 - alpha) background.

    Args:
        albedo: (M, 3) float32, linear, 0 to 1.
        normal: (M, 3) unit normals in world space; a point with a zero normal sees no light and gets no
            gradient.
        roughness: (M, 1), clamped to 0 to 1.
        specular: (M, 1) reflectance f at normal incidence.
        response_diffuse: (M, 1) tau_d.
        response_specular: (M, 1) tau_s.
        view: (M, 3) unit directions from the point to the camera.
        light: The filtered light, on the same device.
        alpha: (M, 1) coverage; None covers every point. Where it is below 1/255 there is no surface, and next
            to no work: C_fg, L_d and L_s are 0, and only alpha itself gets a gradient.
        background: Display values behind: a number or (M, 3); a constant.
        exposure: Factor on C_fg; a constant.
        color_space: "srgb" encodes C_fg; "raw" takes its values for display values.

    Returns:
        Colours, differentiable in the surface, the view, alpha and the light's maps.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_tensor("albedo", albedo, shape=("M", 3))
    check_cubemap("light.irradiance", light.irradiance, channels=3)
    device, count = light.irradiance.device, albedo.shape[0]
    for index, mip in enumerate(light.specular):
        check_cubemap(f"light.specular[{index}]", mip, channels=3, device=device)
    surface = {
        "albedo": albedo,
        "normal": normal,
        "roughness": roughness,
        "specular": specular,
        "response_diffuse": response_diffuse,
        "response_specular": response_specular,
        "view": view,
        "alpha": torch.ones(count, 1, device=device) if alpha is None else alpha,
    }
    for name, values in surface.items():
        check_tensor(
            name, values, shape=(count, 3 if name in ("albedo", "normal", "view") else 1), device=device
        )
    if isinstance(background, torch.Tensor):
        check_tensor("background", background, shape=(count, 3), device=device)
        background = background.detach()
    else:
        background = torch.full((1, 3), float(background), device=device)
    return shade_gbuffer(
        **surface,
        irradiance=light.irradiance,
        mips=light.specular,
        brdf=brdf_table(device),
        background=background,
        exposure=float(exposure),
        encoded=color_space == "srgb",
    )
