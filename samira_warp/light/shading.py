"""Deferred physically based shading of a G-buffer: Eqs. response_shading, pbr_color and alpha_compose."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from samira_warp.kernels.shading.deferred import Shaded, shade_gbuffer
from samira_warp.light.brdf import brdf_table
from samira_warp.light.color import ColorSpace, compose
from samira_warp.light.equirect import turn_directions
from samira_warp.light.filtered import FilteredLight
from samira_warp.support.tone_names import ToneMap
from samira_warp.surface import Surface


def shade(
    surface: Surface,
    view: Tensor,
    light: FilteredLight,
    *,
    alpha: Tensor | None = None,
    background: Tensor | float = 1.0,
    color_space: ColorSpace = "srgb",
    tone_map: ToneMap = "none",
) -> Shaded:
    """Shade M points of a G-buffer and compose them with what is behind.

    L_d = tau_d v_d E_d(n) / (1 - a (1 - o)), L_s = tau_s v_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d +
    L_s (f B_x + B_y), and I = alpha encode(C_fg) + (1 - alpha) background; E_d and E_s are the light's as it
    is turned and exposed, and v_d, v_s and o the surface's channels of what arrives (1 in the open).

    Args:
        surface: Channels (M, width) float32. A point with a zero normal sees no light and gets no gradient;
            roughness is clamped to 0 to 1.
        view: (M, 3) unit directions from the point to the camera.
        light: The filtered light, on the same device.
        alpha: (M, 1) coverage; None covers every point. Where it is below 1/255 there is no surface, and next
            to no work: C_fg, L_d and L_s are 0, and only alpha itself gets a gradient.
        background: Display values behind: a number, (M, 3), or (1, 3) for all points; a constant.
        color_space: "srgb" encodes C_fg; "raw" takes its values for display values.
        tone_map: What becomes of C_fg before it is encoded (`samira_warp.light.to_display`).

    Returns:
        Colours, differentiable in the surface, the view, alpha and the light's maps.

    Raises:
        UserError: A wrong shape, dtype or device; the light's maps are called irradiance and mips. Or a tone
            map is asked for image values.
    """
    if light.rotate != 0.0:
        # A light that turns is seen by a scene that turns the other way: nothing has to be filtered again.
        view = turn_directions(view, light.rotate)
        surface = surface.map(lambda directions: turn_directions(directions, light.rotate), blend="direction")
    if light.exposure != 1.0:
        # L = tau E: a light that is so many times as bright is a surface that responds so many times as much.
        surface = replace(
            surface,
            response_diffuse=light.exposure * surface.response_diffuse,
            response_specular=light.exposure * surface.response_specular,
        )
    device = light.irradiance.device
    if alpha is None:
        alpha = view.new_ones(len(view), 1)
    if not isinstance(background, Tensor):
        background = torch.full((1, 3), float(background), device=device)
    shaded = shade_gbuffer(
        surface,
        view,
        alpha,
        irradiance=light.irradiance,
        mips=light.specular,
        brdf=brdf_table(device),
        background=background,
        encoded=color_space == "srgb",
    )
    if tone_map == "none":
        return shaded
    image = compose(shaded.color, alpha, background, color_space=color_space, tone_map=tone_map)
    return shaded._replace(image=image)
