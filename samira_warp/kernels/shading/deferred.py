"""The whole deferred pass over a G-buffer in one kernel (Eqs. response_shading, pbr_color and alpha_compose),
and its adjoint in three.

Each point is read once, shaded, turned into display values and laid on the background; a point that nothing
covers is left at once. The adjoint recomputes the pass for each point, and leaves the light's texels to
`kernels.cubemap_lookup.texel_gradient`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from torch.autograd.function import once_differentiable

from samira_warp.kernels.cubemap.cell import blend_cell, cell_slope, look_up, read_cell
from samira_warp.kernels.cubemap.layout import (
    FacePoint,
    cell_count,
    cell_index,
    footprint,
    mip_table,
    project,
    project_adjoint,
)
from samira_warp.kernels.cubemap.lookup import level_moves, lower_level, pack_mips, texel_gradient
from samira_warp.kernels.runtime import launch_range
from samira_warp.kernels.shading.brdf import brdf_slope_cosine, brdf_slope_roughness, find_brdf, read_brdf
from samira_warp.kernels.shading.display import show, show_adjoint
from samira_warp.support.constants import COVERED_ALPHA

_GRAIN = 2048
"""Fewer points than this cost less than handing them to a thread."""

_COVERED = wp.constant(COVERED_ALPHA)


class Shaded(NamedTuple):
    """A shaded surface, M points.

    Attributes:
        color: (M, 3) C_fg of Eq. pbr_color, linear radiance; 0 where nothing covers the point.
        image: (M, 3) I of Eq. alpha_compose, display values, not clipped.
        irradiance: (M, 3) L_d = tau_d E_d(n), linear; 0 where nothing covers the point.
        specular_light: (M, 3) L_s = tau_s E_s(n, v, rho), linear, before the BRDF; 0 where nothing covers the
            point.
    """

    color: torch.Tensor
    image: torch.Tensor
    irradiance: torch.Tensor
    specular_light: torch.Tensor


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
    """Shade M points and compose them with what is behind.

    L_d = tau_d E_d(n), L_s = tau_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d + L_s (f B_x + B_y), and
    I = alpha encode(C_fg exposure) + (1 - alpha) background.

    Args:
        albedo: (M, 3) float32, as is all else; linear.
        normal: (M, 3) unit vectors; a point with a zero normal sees no light and gets no gradient.
        roughness: (M, 1), clamped to 0 to 1.
        specular: (M, 1) reflectance f at normal incidence.
        response_diffuse: (M, 1) tau_d.
        response_specular: (M, 1) tau_s.
        view: (M, 3) unit vectors to the camera.
        alpha: (M, 1) coverage. Below 1/255 there is no surface: C_fg, L_d and L_s are 0, and only alpha
            itself gets a gradient.
        irradiance: (6, S, S, 3) map of E_d.
        mips: L maps (6, S_l, S_l, 3) of E_s at roughness 0 to 1 in equal steps.
        brdf: (N, N, 2) table of (B_x, B_y) at nodes: rows by roughness, columns by the root of n . v, both
            from 0 to 1; a constant.
        background: (M, 3) display values, or (1, 3) for all points; a constant.
        exposure: Factor on C_fg.
        encoded: Whether display values are sRGB-encoded, rather than C_fg times the exposure.

    Returns:
        Colours; differentiable in all but ``brdf``, ``background`` and ``exposure``.
    """
    sizes = tuple(mip.shape[1] for mip in mips)
    surface = (albedo, normal, roughness, specular, response_diffuse, response_specular, view, alpha)
    options = (brdf, background, irradiance.shape[1], sizes, (exposure, encoded))
    return Shaded(*_Shade.apply(*surface, irradiance.reshape(-1, 3), pack_mips(mips), *options))


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, size, sizes, display = inputs
        tensors = [tensor.contiguous() for tensor in tensors]
        count, device = tensors[0].shape[0], tensors[0].device
        results = tuple(torch.empty(count, 3, device=device) for _ in Shaded._fields)
        launch_range(
            _shade,
            count,
            *_by_kernel(tensors),
            size,
            mip_table(sizes, device),
            *display,
            *results,
            grain=_GRAIN,
        )
        ctx.save_for_backward(*tensors, results[0])
        ctx.size, ctx.sizes, ctx.display = size, sizes, display
        return results

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        *tensors, color = ctx.saved_tensors
        size, sizes, count, device = ctx.size, ctx.sizes, color.shape[0], color.device
        (
            albedo,
            normal,
            roughness,
            specular,
            response_diffuse,
            response_specular,
            view,
            alpha,
            irradiance,
            mips,
            brdf,
            background,
        ) = _by_kernel(tensors)
        grad_color, grad_image, grad_irradiance, grad_light = (grad.contiguous() for grad in grads)
        surface = [torch.empty_like(tensor) for tensor in tensors[:8]]
        to_albedo, to_normal, to_roughness, to_specular, to_diffuse, to_shine, to_view, to_alpha = _by_kernel(
            surface
        )

        to_color = torch.empty_like(color)
        inputs = (color, alpha, background, *ctx.display, grad_color, grad_image)
        launch_range(_display_adjoint, count, *inputs, to_color, to_alpha, grain=_GRAIN)
        diffuse, shine = _Lookups.empty(count, 1, device), _Lookups.empty(count, min(2, len(sizes)), device)
        inputs = (
            albedo,
            normal,
            specular,
            response_diffuse,
            alpha,
            irradiance,
            size,
            to_color,
            grad_irradiance,
        )
        launch_range(
            _diffuse_adjoint,
            count,
            *inputs,
            to_albedo,
            to_normal,
            to_specular,
            to_diffuse,
            *diffuse,
            grain=_GRAIN,
        )
        inputs = (
            normal,
            roughness,
            specular,
            response_specular,
            view,
            alpha,
            mips,
            mip_table(sizes, device),
            brdf,
            to_color,
            grad_light,
        )
        launch_range(
            _specular_adjoint,
            count,
            *inputs,
            to_normal,
            to_roughness,
            to_specular,
            to_shine,
            to_view,
            *shine,
            grain=_GRAIN,
        )
        maps = [
            texel_gradient(lookups.cells, lookups.places, lookups.grads, chain) if wanted else None
            for lookups, chain, wanted in zip(
                (diffuse, shine), ((size,), sizes), ctx.needs_input_grad[8:10], strict=True
            )
        ]
        return (*surface, *maps, None, None, None, None, None)


class _Lookups(NamedTuple):
    """What the adjoint of M lookups in a chain of maps needs, up to R mips each: see
    `kernels.cubemap_lookup.texel_gradient`.
    """

    grads: torch.Tensor
    cells: torch.Tensor
    places: torch.Tensor

    @classmethod
    def empty(cls, count: int, slots: int, device: torch.device) -> _Lookups:
        return cls(
            torch.empty(count, 3, device=device),
            torch.empty(count, slots, dtype=torch.int32, device=device),
            torch.empty(count, slots, 3, device=device),
        )


def _by_kernel(tensors: list[torch.Tensor] | tuple[torch.Tensor, ...]) -> list[torch.Tensor]:
    """The same tensors with the columns (M, 1) as (M,), as the kernels take them."""
    return [tensor.view(-1) if tensor.dim() == 2 and tensor.shape[1] == 1 else tensor for tensor in tensors]


@wp.func
def behind(background: wp.array[wp.vec3], m: wp.int32) -> wp.vec3:
    """The background of a point: its own, or the one for all."""
    return background[wp.where(background.shape[0] == 1, 0, m)]


@wp.func
def is_lit(alpha: wp.float32, normal: wp.vec3) -> wp.bool:
    """Whether a point has a surface, and the surface a direction."""
    return alpha >= _COVERED and wp.length_sq(normal) > 0.0


@wp.kernel(enable_backward=False)
def _shade(
    first: wp.int32,
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response_diffuse: wp.array[wp.float32],
    response_specular: wp.array[wp.float32],
    view: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    irradiance_map: wp.array[wp.vec3],
    mips: wp.array[wp.vec3],
    brdf: wp.array2d[wp.vec2],
    background: wp.array[wp.vec3],
    size: wp.int32,
    table: wp.array2d[wp.int32],
    exposure: wp.float32,
    encoded: wp.bool,
    color: wp.array[wp.vec3],
    image: wp.array[wp.vec3],
    irradiance: wp.array[wp.vec3],
    specular_light: wp.array[wp.vec3],
) -> None:
    m = first + wp.tid()
    n = normal[m]
    rest = (1.0 - alpha[m]) * behind(background, m)
    if not is_lit(alpha[m], n):
        color[m] = wp.vec3()
        image[m] = rest
        irradiance[m] = wp.vec3()
        specular_light[m] = wp.vec3()
        return
    cell = footprint(project(n), size)
    diffuse = response_diffuse[m] * blend_cell(cell, read_cell(irradiance_map, 0, cell, size))
    cosine = wp.dot(n, view[m])
    level = roughness[m] * wp.float32(table.shape[0] - 1)
    light = response_specular[m] * look_up(mips, table, project(2.0 * cosine * n - view[m]), level)
    b = read_brdf(brdf, find_brdf(roughness[m], cosine, brdf.shape[0]))
    radiance = (1.0 - specular[m]) * wp.cw_mul(albedo[m], diffuse) + (specular[m] * b[0] + b[1]) * light
    color[m] = radiance
    image[m] = alpha[m] * show(radiance, exposure, encoded) + rest
    irradiance[m] = diffuse
    specular_light[m] = light


@wp.kernel(enable_backward=False)
def _display_adjoint(
    first: wp.int32,
    color: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    background: wp.array[wp.vec3],
    exposure: wp.float32,
    encoded: wp.bool,
    upstream_color: wp.array[wp.vec3],
    grad_image: wp.array[wp.vec3],
    grad_color: wp.array[wp.vec3],
    grad_alpha: wp.array[wp.float32],
) -> None:
    """Adjoint of I = alpha encode(C exposure) + (1 - alpha) background, added to what flows into C from
    elsewhere.
    """
    m = first + wp.tid()
    if alpha[m] < _COVERED:
        grad_color[m] = wp.vec3()
        grad_alpha[m] = -wp.dot(behind(background, m), grad_image[m])
        return
    grad_color[m] = upstream_color[m] + alpha[m] * show_adjoint(color[m], exposure, encoded, grad_image[m])
    grad_alpha[m] = wp.dot(show(color[m], exposure, encoded) - behind(background, m), grad_image[m])


@wp.kernel(enable_backward=False)
def _diffuse_adjoint(
    first: wp.int32,
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    specular: wp.array[wp.float32],
    response: wp.array[wp.float32],
    alpha: wp.array[wp.float32],
    irradiance_map: wp.array[wp.vec3],
    size: wp.int32,
    grad_color: wp.array[wp.vec3],
    grad_irradiance: wp.array[wp.vec3],
    grad_albedo: wp.array[wp.vec3],
    grad_normal: wp.array[wp.vec3],
    grad_specular: wp.array[wp.float32],
    grad_response: wp.array[wp.float32],
    grad_lookup: wp.array[wp.vec3],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    """Adjoint of C = a (1 - f) L_d + ..., L_d = tau_d E_d(n)."""
    m = first + wp.tid()
    n = normal[m]
    if not is_lit(alpha[m], n):
        grad_albedo[m] = wp.vec3()
        grad_normal[m] = wp.vec3()
        grad_specular[m] = 0.0
        grad_response[m] = 0.0
        cells[m, 0] = cell_count(size)
        return
    point = project(n)
    cell = footprint(point, size)
    texels = read_cell(irradiance_map, 0, cell, size)
    irradiance = blend_cell(cell, texels)
    grad_l_d = grad_irradiance[m] + (1.0 - specular[m]) * wp.cw_mul(albedo[m], grad_color[m])
    grad_e_d = response[m] * grad_l_d
    slope = 0.5 * wp.float32(size) * cell_slope(cell, texels, grad_e_d)
    grad_product = response[m] * wp.cw_mul(irradiance, grad_color[m])
    grad_albedo[m] = (1.0 - specular[m]) * grad_product
    grad_specular[m] = -wp.dot(albedo[m], grad_product)
    grad_response[m] = wp.dot(irradiance, grad_l_d)
    grad_normal[m] = project_adjoint(n, point, slope[0], slope[1])
    grad_lookup[m] = grad_e_d
    cells[m, 0] = cell_index(cell, size)
    places[m, 0] = wp.vec3(cell.x, cell.y, 1.0)


@wp.struct
class _Lookup:
    """A trilinear lookup again: its value E_s, and the gradients by the place on the cube's face and by the
    level.
    """

    light: wp.vec3
    slope: wp.vec2
    grad_level: wp.float32


@wp.func
def _look_up_again(
    mips: wp.array[wp.vec3],
    table: wp.array2d[wp.int32],
    point: FacePoint,
    level: wp.float32,
    grad: wp.vec3,
    m: wp.int32,
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> _Lookup:
    """Repeat `look_up` for the gradient of its value, and note the cells of point m, for `texel_gradient`."""
    lower, fraction = lower_level(level, table.shape[0])
    result = _Lookup()
    for slot in range(cells.shape[1]):
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        size = table[lower + slot, 0]
        cell = footprint(point, size)
        texels = read_cell(mips, table[lower + slot, 1], cell, size)
        value = blend_cell(cell, texels)
        result.light += share * value
        result.slope += 0.5 * wp.float32(size) * share * cell_slope(cell, texels, grad)
        result.grad_level += wp.where(slot == 0, -1.0, 1.0) * wp.dot(value, grad)
        cells[m, slot] = table[lower + slot, 2] + cell_index(cell, size)
        places[m, slot] = wp.vec3(cell.x, cell.y, share)
    return result


@wp.kernel(enable_backward=False)
def _specular_adjoint(
    first: wp.int32,
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response: wp.array[wp.float32],
    view: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    mips: wp.array[wp.vec3],
    table: wp.array2d[wp.int32],
    brdf: wp.array2d[wp.vec2],
    grad_color: wp.array[wp.vec3],
    grad_specular_light: wp.array[wp.vec3],
    grad_normal: wp.array[wp.vec3],
    grad_roughness: wp.array[wp.float32],
    grad_specular: wp.array[wp.float32],
    grad_response: wp.array[wp.float32],
    grad_view: wp.array[wp.vec3],
    grad_lookup: wp.array[wp.vec3],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    """Adjoint of C = ... + L_s (f B_x + B_y), L_s = tau_s E_s(r, rho); adds to the gradients of normal and f
    that the diffuse part left.
    """
    m = first + wp.tid()
    n = normal[m]
    v = view[m]
    f = specular[m]
    levels = table.shape[0]
    if not is_lit(alpha[m], n):
        grad_roughness[m] = 0.0
        grad_response[m] = 0.0
        grad_view[m] = wp.vec3()
        for slot in range(cells.shape[1]):
            cells[m, slot] = table[levels - 1, 2] + cell_count(table[levels - 1, 0])
        return
    cosine = wp.dot(n, v)
    place = find_brdf(roughness[m], cosine, brdf.shape[0])
    b = read_brdf(brdf, place)
    grad_l_s = grad_specular_light[m] + (f * b[0] + b[1]) * grad_color[m]
    grad_e_s = response[m] * grad_l_s

    r = 2.0 * cosine * n - v
    point = project(r)
    level = roughness[m] * wp.float32(levels - 1)
    seen = _look_up_again(mips, table, point, level, grad_e_s, m, cells, places)
    light = seen.light
    grad_r = project_adjoint(r, point, seen.slope[0], seen.slope[1])

    grad_factor = response[m] * wp.dot(light, grad_color[m])
    grad_b = wp.vec2(f * grad_factor, grad_factor)
    grad_cosine = wp.dot(brdf_slope_cosine(brdf, place), grad_b) + 2.0 * wp.dot(grad_r, n)
    grad_roughness[m] = wp.dot(brdf_slope_roughness(brdf, place), grad_b)
    if level_moves(level, levels):
        grad_roughness[m] += wp.float32(levels - 1) * seen.grad_level
    grad_specular[m] += b[0] * grad_factor
    grad_response[m] = wp.dot(light, grad_l_s)
    grad_normal[m] += 2.0 * cosine * grad_r + grad_cosine * v
    grad_view[m] = grad_cosine * n - grad_r
    grad_lookup[m] = grad_e_s
