"""Deferred shading of a G-buffer in one pass (Eqs. response_shading and pbr_color), and its adjoint in another.

The adjoint recomputes the pass for each point, and leaves the light's texels to `kernels.cubemap_lookup.texel_gradient`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp

from samira_warp.kernels.cubemap import (
    FacePoint,
    Footprint,
    bilinear_weights,
    cell_count,
    cell_index,
    cell_texels,
    footprint,
    mip_table,
    project,
    project_adjoint,
)
from samira_warp.kernels.cubemap_lookup import level_moves, lower_level, pack_mips, texel_gradient
from samira_warp.kernels.runtime import launch_range

_GRAIN = 2048
"""Fewer points than this cost less than handing them to a thread."""

GRAZING = wp.constant(1e-6)
"""Least n . v at which the BRDF table is read: its axis is the root of n . v, whose slope has no bound at 0."""


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


def shade_gbuffer(
    albedo: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    specular: torch.Tensor,
    response_diffuse: torch.Tensor,
    response_specular: torch.Tensor,
    view: torch.Tensor,
    *,
    irradiance: torch.Tensor,
    mips: tuple[torch.Tensor, ...],
    brdf: torch.Tensor,
) -> Shaded:
    """Shade M points: L_d = tau_d E_d(n), L_s = tau_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d + L_s (f B_x + B_y).

    Args:
        albedo: (M, 3) float32, as is all else; linear.
        normal: (M, 3) unit vectors; a point with a zero normal sees no light and gets no gradient.
        roughness: (M, 1), clamped to 0 to 1.
        specular: (M, 1) reflectance f at normal incidence.
        response_diffuse: (M, 1) tau_d.
        response_specular: (M, 1) tau_s.
        view: (M, 3) unit vectors to the camera.
        irradiance: (6, S, S, 3) map of E_d.
        mips: L maps (6, S_l, S_l, 3) of E_s at roughness 0 to 1 in equal steps.
        brdf: (N, N, 2) table of (B_x, B_y) at nodes: rows by roughness, columns by the root of n . v, both from 0 to 1; a constant.

    Returns:
        Colours; differentiable in all but ``brdf``.
    """
    sizes = tuple(mip.shape[1] for mip in mips)
    surface = (albedo, normal, roughness, specular, response_diffuse, response_specular, view)
    return Shaded(*_Shade.apply(*surface, irradiance.reshape(-1, 3), pack_mips(mips), brdf, irradiance.shape[1], sizes))


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, size, sizes = inputs
        tensors = [tensor.contiguous() for tensor in tensors]
        ctx.save_for_backward(*tensors)
        ctx.size, ctx.sizes = size, sizes
        count, device = tensors[0].shape[0], tensors[0].device
        results = tuple(torch.empty(count, 3, device=device) for _ in Shaded._fields)
        launch_range(_shade, count, *_by_kernel(tensors), size, mip_table(sizes, device), *results, grain=_GRAIN)
        return results

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        tensors, size, sizes = ctx.saved_tensors, ctx.size, ctx.sizes
        count, device = tensors[0].shape[0], tensors[0].device
        albedo, normal, roughness, specular, response_diffuse, response_specular, view, irradiance, mips, brdf = _by_kernel(tensors)
        grad_color, grad_irradiance, grad_light, grad_shine = (grad.contiguous() for grad in grads)
        surface = [torch.empty_like(tensor) for tensor in tensors[:7]]
        to_albedo, to_normal, to_roughness, to_specular, to_diffuse, to_shine, to_view = _by_kernel(surface)

        def lookups(slots: int) -> tuple[torch.Tensor, ...]:
            options = {"device": device}
            return (
                torch.empty(count, 3, **options),
                torch.empty(count, slots, dtype=torch.int32, **options),
                torch.empty(count, slots, 3, **options),
            )

        diffuse, shine = lookups(1), lookups(min(2, len(sizes)))
        inputs = (albedo, normal, specular, response_diffuse, irradiance, size, grad_color, grad_irradiance)
        launch_range(_diffuse_adjoint, count, *inputs, to_albedo, to_normal, to_specular, to_diffuse, *diffuse, grain=_GRAIN)
        inputs = (normal, roughness, specular, response_specular, view, mips, mip_table(sizes, device), brdf)
        inputs = (*inputs, grad_color, grad_light, grad_shine)
        launch_range(_specular_adjoint, count, *inputs, to_normal, to_roughness, to_specular, to_shine, to_view, *shine, grain=_GRAIN)
        maps = [
            texel_gradient(cells, places, values, chain) if wanted else None
            for (values, cells, places), chain, wanted in zip((diffuse, shine), ((size,), sizes), ctx.needs_input_grad[7:9], strict=True)
        ]
        return (*surface, *maps, None, None, None)


def _by_kernel(tensors: list[torch.Tensor] | tuple[torch.Tensor, ...]) -> list[torch.Tensor]:
    """The same tensors with the columns (M, 1) as (M,), as the kernels take them."""
    return [tensor.view(-1) if tensor.dim() == 2 and tensor.shape[1] == 1 else tensor for tensor in tensors]


Quad = wp.types.matrix(shape=(4, 3), dtype=wp.float32)
"""The texels of a cell, one a row."""


@wp.func
def read_cell(texels: wp.array[wp.vec3], first: wp.int32, cell: Footprint, size: wp.int32) -> Quad:
    """A cell's texels; where three faces meet, the missing one is the mean of the others."""
    taps = cell_texels(cell, size)
    result = Quad()
    total = wp.vec3()
    for k in range(4):
        if taps[k] >= 0:
            result[k] = texels[first + taps[k]]
            total += result[k]
    for k in range(4):
        if taps[k] < 0:
            result[k] = total / 3.0
    return result


@wp.func
def blend_cell(cell: Footprint, texels: Quad) -> wp.vec3:
    """The bilinear value."""
    weights = bilinear_weights(cell)
    return weights[0] * texels[0] + weights[1] * texels[1] + weights[2] * texels[2] + weights[3] * texels[3]


@wp.func
def cell_slope(cell: Footprint, texels: Quad, grad: wp.vec3) -> wp.vec2:
    """Gradient with respect to the place in the cell, along x and y, from that of the bilinear value."""
    a = wp.dot(texels[0], grad)
    b = wp.dot(texels[1], grad)
    c = wp.dot(texels[2], grad)
    d = wp.dot(texels[3], grad)
    return wp.vec2((b - a) * (1.0 - cell.y) + (d - c) * cell.y, (c - a) * (1.0 - cell.x) + (d - b) * cell.x)


@wp.func
def look_up(mips: wp.array[wp.vec3], table: wp.array2d[wp.int32], point: FacePoint, level: wp.float32) -> wp.vec3:
    """Trilinear lookup in a packed chain of mips."""
    lower, fraction = lower_level(level, table.shape[0])
    result = wp.vec3()
    for slot in range(2):
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        if share > 0.0:
            size = table[lower + slot, 0]
            cell = footprint(point, size)
            result += share * blend_cell(cell, read_cell(mips, table[lower + slot, 1], cell, size))
    return result


@wp.struct
class BrdfPlace:
    """A point in the BRDF table: the node before it, the place between nodes, and the slopes of both by roughness and n . v."""

    row: wp.int32
    column: wp.int32
    y: wp.float32
    x: wp.float32
    y_slope: wp.float32
    x_slope: wp.float32


@wp.func
def find_brdf(roughness: wp.float32, cosine: wp.float32, nodes: wp.int32) -> BrdfPlace:
    """Where the BRDF table is read."""
    last = wp.float32(nodes - 1)
    root = wp.sqrt(wp.clamp(cosine, GRAZING, 1.0))
    place = BrdfPlace()
    y = wp.clamp(roughness, 0.0, 1.0) * last
    x = root * last
    place.row = wp.clamp(wp.int32(y), 0, nodes - 2)
    place.column = wp.clamp(wp.int32(x), 0, nodes - 2)
    place.y = y - wp.float32(place.row)
    place.x = x - wp.float32(place.column)
    place.y_slope = wp.where(roughness >= 0.0 and roughness <= 1.0, last, 0.0)
    place.x_slope = wp.where(cosine >= GRAZING and cosine <= 1.0, 0.5 * last / root, 0.0)
    return place


@wp.func
def brdf_row(brdf: wp.array2d[wp.vec2], row: wp.int32, place: BrdfPlace) -> wp.vec2:
    """(B_x, B_y) between the nodes of one row."""
    return (1.0 - place.x) * brdf[row, place.column] + place.x * brdf[row, place.column + 1]


@wp.func
def read_brdf(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """(B_x, B_y), bilinear."""
    return (1.0 - place.y) * brdf_row(brdf, place.row, place) + place.y * brdf_row(brdf, place.row + 1, place)


@wp.func
def brdf_slope_roughness(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """Slope of (B_x, B_y) along the roughness."""
    return place.y_slope * (brdf_row(brdf, place.row + 1, place) - brdf_row(brdf, place.row, place))


@wp.func
def brdf_slope_cosine(brdf: wp.array2d[wp.vec2], place: BrdfPlace) -> wp.vec2:
    """Slope of (B_x, B_y) along n . v."""
    upper = brdf[place.row, place.column + 1] - brdf[place.row, place.column]
    lower = brdf[place.row + 1, place.column + 1] - brdf[place.row + 1, place.column]
    return place.x_slope * ((1.0 - place.y) * upper + place.y * lower)


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
    irradiance_map: wp.array[wp.vec3],
    mips: wp.array[wp.vec3],
    brdf: wp.array2d[wp.vec2],
    size: wp.int32,
    table: wp.array2d[wp.int32],
    color: wp.array[wp.vec3],
    irradiance: wp.array[wp.vec3],
    specular_light: wp.array[wp.vec3],
    specular_color: wp.array[wp.vec3],
) -> None:
    m = first + wp.tid()
    n = normal[m]
    diffuse = wp.vec3()
    light = wp.vec3()
    cosine = wp.dot(n, view[m])
    if wp.length_sq(n) > 0.0:
        cell = footprint(project(n), size)
        diffuse = response_diffuse[m] * blend_cell(cell, read_cell(irradiance_map, 0, cell, size))
        level = roughness[m] * wp.float32(table.shape[0] - 1)
        light = response_specular[m] * look_up(mips, table, project(2.0 * cosine * n - view[m]), level)
    b = read_brdf(brdf, find_brdf(roughness[m], cosine, brdf.shape[0]))
    shine = (specular[m] * b[0] + b[1]) * light
    irradiance[m] = diffuse
    specular_light[m] = light
    specular_color[m] = shine
    color[m] = (1.0 - specular[m]) * wp.cw_mul(albedo[m], diffuse) + shine


@wp.kernel(enable_backward=False)
def _diffuse_adjoint(
    first: wp.int32,
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    specular: wp.array[wp.float32],
    response: wp.array[wp.float32],
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
    if wp.length_sq(n) == 0.0:
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


@wp.kernel(enable_backward=False)
def _specular_adjoint(
    first: wp.int32,
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response: wp.array[wp.float32],
    view: wp.array[wp.vec3],
    mips: wp.array[wp.vec3],
    table: wp.array2d[wp.int32],
    brdf: wp.array2d[wp.vec2],
    grad_color: wp.array[wp.vec3],
    grad_specular_light: wp.array[wp.vec3],
    grad_specular_color: wp.array[wp.vec3],
    grad_normal: wp.array[wp.vec3],
    grad_roughness: wp.array[wp.float32],
    grad_specular: wp.array[wp.float32],
    grad_response: wp.array[wp.float32],
    grad_view: wp.array[wp.vec3],
    grad_lookup: wp.array[wp.vec3],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    """Adjoint of C = ... + L_s (f B_x + B_y), L_s = tau_s E_s(r, rho); adds to the gradients of normal and f that the diffuse part left."""
    m = first + wp.tid()
    n = normal[m]
    v = view[m]
    f = specular[m]
    levels = table.shape[0]
    if wp.length_sq(n) == 0.0:
        grad_roughness[m] = 0.0
        grad_response[m] = 0.0
        grad_view[m] = wp.vec3()
        for slot in range(cells.shape[1]):
            cells[m, slot] = table[levels - 1, 2] + cell_count(table[levels - 1, 0])
        return
    cosine = wp.dot(n, v)
    place = find_brdf(roughness[m], cosine, brdf.shape[0])
    b = read_brdf(brdf, place)
    grad_shine = grad_color[m] + grad_specular_color[m]
    grad_l_s = grad_specular_light[m] + (f * b[0] + b[1]) * grad_shine
    grad_e_s = response[m] * grad_l_s

    r = 2.0 * cosine * n - v
    point = project(r)
    level = roughness[m] * wp.float32(levels - 1)
    lower, fraction = lower_level(level, levels)
    light = wp.vec3()
    slope = wp.vec2()
    grad_level = wp.float32(0.0)
    for slot in range(cells.shape[1]):
        share = wp.where(slot == 0, 1.0 - fraction, fraction)
        size = table[lower + slot, 0]
        cell = footprint(point, size)
        texels = read_cell(mips, table[lower + slot, 1], cell, size)
        value = blend_cell(cell, texels)
        light += share * value
        slope += 0.5 * wp.float32(size) * share * cell_slope(cell, texels, grad_e_s)
        grad_level += wp.where(slot == 0, -1.0, 1.0) * wp.dot(value, grad_e_s)
        cells[m, slot] = table[lower + slot, 2] + cell_index(cell, size)
        places[m, slot] = wp.vec3(cell.x, cell.y, share)
    grad_r = project_adjoint(r, point, slope[0], slope[1])

    grad_factor = response[m] * wp.dot(light, grad_shine)
    grad_b = wp.vec2(f * grad_factor, grad_factor)
    grad_cosine = wp.dot(brdf_slope_cosine(brdf, place), grad_b) + 2.0 * wp.dot(grad_r, n)
    grad_roughness[m] = wp.dot(brdf_slope_roughness(brdf, place), grad_b)
    if level_moves(level, levels):
        grad_roughness[m] += wp.float32(levels - 1) * grad_level
    grad_specular[m] += b[0] * grad_factor
    grad_response[m] = wp.dot(light, grad_l_s)
    grad_normal[m] += 2.0 * cosine * grad_r + grad_cosine * v
    grad_view[m] = grad_cosine * n - grad_r
    grad_lookup[m] = grad_e_s
