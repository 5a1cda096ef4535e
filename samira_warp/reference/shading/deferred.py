"""Deferred shading in plain torch, for any floating dtype: the twin of `kernels.shading.deferred`."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.shading.brdf import GRAZING
from samira_warp.kernels.shading.deferred import Shaded
from samira_warp.light.color import compose
from samira_warp.reference.cubemap.lookup import sample_cubemap, sample_mips
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.surface import Surface


def shade_gbuffer(
    surface: Surface,
    view: Tensor,
    alpha: Tensor,
    *,
    irradiance: Tensor,
    mips: tuple[Tensor, ...],
    brdf: Tensor,
    background: Tensor,
    encoded: bool = True,
) -> Shaded:
    """See `kernels.shading.deferred.shade_gbuffer`; normals are not zero."""
    normal, f = surface.normal, surface.specular
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = 2 * cosine * normal - view
    covered = alpha >= COVERED_ALPHA
    level = surface.roughness[:, 0] * (len(mips) - 1)
    bounces = 1 / (1 - surface.albedo * (1 - surface.ambient_occlusion))
    arriving = surface.visibility * sample_cubemap(irradiance, normal)
    diffuse = covered * surface.response_diffuse * bounces * arriving
    visible = surface.response_specular * surface.visibility_specular
    light = covered * visible * sample_mips(mips, reflected, level)
    scale, bias = lookup_brdf(brdf, surface.roughness, cosine)
    color = surface.albedo * (1 - f) * diffuse + light * (f * scale + bias)
    image = compose(color, alpha, background, color_space="srgb" if encoded else "raw")
    return Shaded(color, image, diffuse, light)


def lookup_brdf(brdf: Tensor, roughness: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor]:
    """B_x and B_y, each (M, 1), bilinear in a table of nodes.

    Args:
        brdf: (N, N, 2).
        roughness: (M, 1), clamped to [0, 1].
        cosine: (M, 1) n . v, likewise.
    """
    nodes = brdf.shape[0]
    table = brdf.to(roughness.dtype).view(-1, 2)
    x = torch.sqrt(cosine.clamp(GRAZING, 1.0)) * (nodes - 1)
    y = roughness.clamp(0.0, 1.0) * (nodes - 1)
    column = x.detach().long().clamp(max=nodes - 2)
    row = y.detach().long().clamp(max=nodes - 2)
    x, y = x - column, y - row
    first = (row * nodes + column)[:, 0]
    upper = table[first] * (1 - x) + table[first + 1] * x
    lower = table[first + nodes] * (1 - x) + table[first + nodes + 1] * x
    terms = upper * (1 - y) + lower * y
    return terms[:, :1], terms[:, 1:]
