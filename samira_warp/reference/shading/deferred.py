"""Deferred shading in plain torch, for any floating dtype: the specification of
`kernels.deferred_shading`.
"""

from __future__ import annotations

import torch

from samira_warp.kernels.shading.brdf import GRAZING
from samira_warp.kernels.shading.deferred import Shaded
from samira_warp.light.color import compose
from samira_warp.reference.cubemap.layout import sample_cubemap, sample_mips
from samira_warp.support.constants import COVERED_ALPHA


def shade_gbuffer(
    albedo: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    specular: torch.Tensor,
    response_diffuse: torch.Tensor,
    response_specular: torch.Tensor,
    view: torch.Tensor,
    alpha: torch.Tensor,
    *,
    irradiance: torch.Tensor,
    mips: tuple[torch.Tensor, ...],
    brdf: torch.Tensor,
    background: torch.Tensor,
    exposure: float = 1.0,
    encoded: bool = True,
) -> Shaded:
    """See `kernels.deferred_shading.shade_gbuffer`; normals are not zero."""
    cosine = (normal * view).sum(dim=-1, keepdim=True)
    reflected = 2 * cosine * normal - view
    covered = alpha >= COVERED_ALPHA
    diffuse = covered * response_diffuse * sample_cubemap(irradiance, normal)
    light = covered * response_specular * sample_mips(mips, reflected, roughness[:, 0] * (len(mips) - 1))
    scale, bias = lookup_brdf(brdf, roughness, cosine)
    color = albedo * (1 - specular) * diffuse + light * (specular * scale + bias)
    image = compose(color, alpha, background, exposure=exposure, color_space="srgb" if encoded else "raw")
    return Shaded(color, image, diffuse, light)


def lookup_brdf(
    brdf: torch.Tensor, roughness: torch.Tensor, cosine: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """B_x and B_y, each (M, 1), bilinear in the table (N, N, 2), at ``roughness`` and ``cosine`` = n . v, (M,
    1), clamped to [0, 1].
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
