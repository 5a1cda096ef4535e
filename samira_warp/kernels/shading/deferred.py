"""The whole deferred pass over a G-buffer in one kernel, and its adjoint in three.

Eqs. response_shading, pbr_color and alpha_compose. Each point is read once, shaded, turned into display
values and laid on the background; a point that nothing covers is left at once. The adjoint recomputes the
pass for each point, and leaves the light's texels to `kernels.cubemap.lookup.texel_gradient`.

Kernels get their arguments by name: a channel of `samira_warp.surface` is what the parameter of its name
reads, and its gradient what the parameter called ``grad_`` and its name writes.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.cubemap.cell import blend_cell, cell_slope, look_up, read_cell
from samira_warp.kernels.cubemap.layout import (
    FacePoint,
    cell_count,
    cell_index,
    find_face,
    find_face_adjoint,
    footprint,
    mip_table,
)
from samira_warp.kernels.cubemap.lookup import level_moves, lower_level, pack_mips, texel_gradient
from samira_warp.kernels.runtime import launch_range
from samira_warp.kernels.shading.brdf import brdf_slope_cosine, brdf_slope_roughness, find_brdf, read_brdf
from samira_warp.kernels.shading.checks import check_background, check_light, check_surface
from samira_warp.kernels.shading.display import show, show_adjoint
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.validation import check_tensors
from samira_warp.surface import CHANNELS, Surface

GRAIN = 2048
"""Points that are worth a thread."""

_COVERED = wp.constant(COVERED_ALPHA)

_POINTWISE = (*CHANNELS, "view", "alpha")
_DIFFERENTIABLE = (*_POINTWISE, "irradiance_map", "mips")
"""What has a gradient, by its name in the kernels, in the order in which `_Shade` takes it; those above have
one value a point."""


class Shaded(NamedTuple):
    """A shaded surface, M points.

    Attributes:
        color: (M, 3) C_fg of Eq. pbr_color, linear radiance; 0 where nothing covers the point.
        image: (M, 3) I of Eq. alpha_compose, display values, not clipped.
        irradiance: (M, 3) L_d, linear; 0 where nothing covers the point.
        specular_light: (M, 3) L_s, linear, before the BRDF; 0 where nothing covers the point.
    """

    color: Tensor
    image: Tensor
    irradiance: Tensor
    specular_light: Tensor


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
    """Shade M points and compose them with what is behind.

    L_d = tau_d v_d E_d(n) / (1 - a (1 - o)), L_s = tau_s v_s E_s(reflect(v, n), rho), C_fg = a (1 - f) L_d +
    L_s (f B_x + B_y), and I = alpha encode(C_fg) + (1 - alpha) background; v_d, v_s and o say what of the
    light arrives and are 1 in the open.

    Args:
        surface: Channels (M, width) float32, as is all else. A point with a zero normal sees no light and
            gets no gradient; roughness is clamped to 0 to 1. a (1 - o) is below 1.
        view: (M, 3) unit vectors to the camera.
        alpha: (M, 1) coverage. Below 1/255 there is no surface: C_fg, L_d and L_s are 0, and only alpha
            itself gets a gradient.
        irradiance: (6, S, S, 3) map of E_d.
        mips: L maps (6, S_l, S_l, 3) of E_s at roughness 0 to 1 in equal steps.
        brdf: (N, N, 2) table of (B_x, B_y) at nodes: rows by roughness, columns by the root of n . v, both
            from 0 to 1; a constant.
        background: (M, 3) display values, or (1, 3) for all points; a constant.
        encoded: Whether display values are sRGB-encoded, rather than C_fg itself.

    Returns:
        Colours; differentiable in all but ``brdf`` and ``background``.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_surface(surface)
    count, device = len(surface.normal), surface.normal.device
    check_tensors(("view", view, (count, 3)), ("alpha", alpha, (count, 1)), device=device)
    check_light(irradiance, mips, brdf, device=device)
    check_background(background, count=count, device=device)
    differentiable = {
        **surface.channels(),
        "view": view,
        "alpha": alpha,
        "irradiance_map": irradiance.reshape(-1, 3),
        "mips": pack_mips(mips),
    }
    constants = {"brdf": brdf, "background": background.detach()}
    options = _Options(irradiance.shape[1], tuple(mip.shape[1] for mip in mips), encoded)
    return Shaded(*_Shade.apply(options, constants, *(differentiable[name] for name in _DIFFERENTIABLE)))


class _Options(NamedTuple):
    """What of the pass is no tensor: S of the irradiance map and of each mip, and how colours are shown."""

    size: int
    sizes: tuple[int, ...]
    encoded: bool

    def arguments(self, device: torch.device) -> dict[str, Any]:
        """The same by the kernels' names."""
        return {
            "size": self.size,
            "table": mip_table(self.sizes, device),
            "encoded": self.encoded,
        }


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, options: _Options, constants: dict[str, Tensor], *differentiable: Tensor
    ) -> tuple[Tensor, ...]:
        inputs = dict(zip(_DIFFERENTIABLE, differentiable, strict=True)) | constants
        inputs = {name: tensor.contiguous() for name, tensor in inputs.items()}
        view = inputs["view"]
        shaded = Shaded(*(torch.empty_like(view) for _ in Shaded._fields))
        given = _by_kernel(inputs) | options.arguments(view.device)
        _launch(_shade, len(view), given | shaded._asdict())
        ctx.save_for_backward(*inputs.values(), shaded.color)
        ctx.names, ctx.options = (*inputs, "color"), options
        return tuple(shaded)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        inputs, options = dict(zip(ctx.names, ctx.saved_tensors, strict=True)), ctx.options
        color = inputs["color"]
        count, device = len(color), color.device
        grads = {name: torch.empty_like(inputs[name]) for name in _POINTWISE if f"grad_{name}" in _written()}
        diffuse = _Lookups.empty(count, 1, device)
        shine = _Lookups.empty(count, min(2, len(options.sizes)), device)
        given = options.arguments(device) | _by_kernel(
            {
                **inputs,
                **{f"grad_{name}": grad for name, grad in grads.items()},
                "grad_radiance": torch.empty_like(color),
                **{
                    f"grad_{name}": grad.contiguous()
                    for name, grad in zip(Shaded._fields, upstream, strict=True)
                },
            }
        )

        # from the image back to C_fg, then through its two terms; the second adds to what the first left
        _launch(_display_adjoint, count, given)
        _launch(_diffuse_adjoint, count, given | diffuse._asdict())
        _launch(_specular_adjoint, count, given | shine._asdict())

        _, _, *needed = ctx.needs_input_grad
        wanted = dict(zip(_DIFFERENTIABLE, needed, strict=True))
        if wanted["irradiance_map"]:
            grads["irradiance_map"] = diffuse.texel_gradient((options.size,))
        if wanted["mips"]:
            grads["mips"] = shine.texel_gradient(options.sizes)
        return None, None, *(grads.get(name) for name in _DIFFERENTIABLE)


class _Lookups(NamedTuple):
    """What the adjoint of M lookups in a chain of maps leaves for its texels, up to R mips each.

    See `kernels.cubemap.lookup.texel_gradient`; the names are the kernels'.
    """

    grad_lookup: Tensor
    cells: Tensor
    places: Tensor

    @classmethod
    def empty(cls, count: int, slots: int, device: torch.device) -> _Lookups:
        return cls(
            torch.empty(count, 3, device=device),
            torch.empty(count, slots, dtype=torch.int32, device=device),
            torch.empty(count, slots, 3, device=device),
        )

    def texel_gradient(self, sizes: tuple[int, ...]) -> Tensor:
        """(T, 3) gradient of the chain's texels."""
        return texel_gradient(self.cells, self.places, self.grad_lookup, sizes)


@functools.cache
def _written() -> frozenset[str]:
    """The parameters of the adjoint's kernels: a gradient that is none of them is zero."""
    adjoints = (_display_adjoint, _diffuse_adjoint, _specular_adjoint)
    return frozenset(name for kernel in adjoints for name in _parameters(kernel))


def _by_kernel(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors with the columns (M, 1) as (M,), as the kernels take them."""
    return {
        name: tensor.view(-1) if tensor.dim() == 2 and tensor.shape[1] == 1 else tensor
        for name, tensor in tensors.items()
    }


def _launch(kernel: wp.Kernel, count: int, values: Mapping[str, Any]) -> None:
    """Run a kernel over points with the values that its parameters are named after."""
    launch_range(kernel, count, *(values[name] for name in _parameters(kernel)), grain=GRAIN)


@functools.cache
def _parameters(kernel: wp.Kernel) -> tuple[str, ...]:
    """The names of a kernel's parameters after ``first``."""
    _, *parameters = kernel.adj.args
    return tuple(parameter.label for parameter in parameters)


@wp.func
def behind(background: wp.array[wp.vec3], m: wp.int32) -> wp.vec3:
    """The background of a point: its own, or the one for all."""
    return background[wp.where(background.shape[0] == 1, 0, m)]


@wp.func
def is_lit(alpha: wp.float32, normal: wp.vec3) -> wp.bool:
    """Whether a point has a surface, and the surface a direction."""
    return alpha >= _COVERED and wp.length_sq(normal) > 0.0


@wp.func
def bounces(albedo: wp.vec3, openness: wp.float32) -> wp.vec3:
    """1 / (1 - a (1 - o)): the light that bounces between a surface and what blocks its view of the sky."""
    blocked = 1.0 - openness
    return wp.vec3(
        1.0 / (1.0 - albedo[0] * blocked),
        1.0 / (1.0 - albedo[1] * blocked),
        1.0 / (1.0 - albedo[2] * blocked),
    )


@wp.kernel(enable_backward=False)
def _shade(
    first: wp.int32,
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response_diffuse: wp.array[wp.float32],
    response_specular: wp.array[wp.float32],
    visibility: wp.array[wp.vec3],
    visibility_specular: wp.array[wp.float32],
    ambient_occlusion: wp.array[wp.float32],
    view: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    irradiance_map: wp.array[wp.vec3],
    mips: wp.array[wp.vec3],
    brdf: wp.array2d[wp.vec2],
    background: wp.array[wp.vec3],
    size: wp.int32,
    table: wp.array2d[wp.int32],
    encoded: wp.bool,
    color: wp.array[wp.vec3],
    image: wp.array[wp.vec3],
    irradiance: wp.array[wp.vec3],
    specular_light: wp.array[wp.vec3],
) -> None:
    """The forward pass."""
    m = first + wp.tid()
    n = normal[m]
    rest = (1.0 - alpha[m]) * behind(background, m)

    # nothing covers the point: it shows the background, and no light is looked up
    if not is_lit(alpha[m], n):
        color[m] = wp.vec3()
        image[m] = rest
        irradiance[m] = wp.vec3()
        specular_light[m] = wp.vec3()
        return

    # L_d = tau_d v_d E_d(n) / (1 - a (1 - o))
    cell = footprint(find_face(n), size)
    arriving = wp.cw_mul(visibility[m], blend_cell(cell, read_cell(irradiance_map, 0, cell, size)))
    diffuse = response_diffuse[m] * wp.cw_mul(bounces(albedo[m], ambient_occlusion[m]), arriving)

    # L_s = tau_s v_s E_s(r, rho), r the view mirrored at the normal
    cosine = wp.dot(n, view[m])
    level = roughness[m] * wp.float32(table.shape[0] - 1)
    seen = look_up(mips, table, find_face(2.0 * cosine * n - view[m]), level)
    light = response_specular[m] * visibility_specular[m] * seen

    # C_fg = a (1 - f) L_d + L_s (f B_x + B_y), and its display values on the background
    b = read_brdf(brdf, find_brdf(roughness[m], cosine, brdf.shape[0]))
    radiance = (1.0 - specular[m]) * wp.cw_mul(albedo[m], diffuse) + (specular[m] * b[0] + b[1]) * light
    color[m] = radiance
    image[m] = alpha[m] * show(radiance, encoded) + rest
    irradiance[m] = diffuse
    specular_light[m] = light


@wp.kernel(enable_backward=False)
def _display_adjoint(
    first: wp.int32,
    alpha: wp.array[wp.float32],
    background: wp.array[wp.vec3],
    encoded: wp.bool,
    color: wp.array[wp.vec3],
    grad_color: wp.array[wp.vec3],
    grad_image: wp.array[wp.vec3],
    grad_radiance: wp.array[wp.vec3],
    grad_alpha: wp.array[wp.float32],
) -> None:
    """Adjoint of I = alpha encode(C_fg) + (1 - alpha) background.

    ``grad_radiance`` is all that flows into C_fg: what comes from the image, and ``grad_color``, what came
    to C_fg itself.
    """
    m = first + wp.tid()
    if alpha[m] < _COVERED:
        grad_radiance[m] = wp.vec3()
        grad_alpha[m] = -wp.dot(behind(background, m), grad_image[m])
        return
    grad_radiance[m] = grad_color[m] + alpha[m] * show_adjoint(color[m], encoded, grad_image[m])
    grad_alpha[m] = wp.dot(show(color[m], encoded) - behind(background, m), grad_image[m])


@wp.kernel(enable_backward=False)
def _diffuse_adjoint(
    first: wp.int32,
    albedo: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    specular: wp.array[wp.float32],
    response_diffuse: wp.array[wp.float32],
    visibility: wp.array[wp.vec3],
    ambient_occlusion: wp.array[wp.float32],
    alpha: wp.array[wp.float32],
    irradiance_map: wp.array[wp.vec3],
    size: wp.int32,
    grad_radiance: wp.array[wp.vec3],
    grad_irradiance: wp.array[wp.vec3],
    grad_albedo: wp.array[wp.vec3],
    grad_normal: wp.array[wp.vec3],
    grad_specular: wp.array[wp.float32],
    grad_response_diffuse: wp.array[wp.float32],
    grad_visibility: wp.array[wp.vec3],
    grad_ambient_occlusion: wp.array[wp.float32],
    grad_lookup: wp.array[wp.vec3],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    """Adjoint of C_fg = a (1 - f) L_d + ..., L_d = tau_d v_d E_d(n) / (1 - a (1 - o)).

    ``grad_irradiance`` is what came to L_d itself. Every gradient is written, as 0 where a point has no
    light; the light's own is left as lookups.
    """
    m = first + wp.tid()
    n = normal[m]
    if not is_lit(alpha[m], n):
        grad_albedo[m] = wp.vec3()
        grad_normal[m] = wp.vec3()
        grad_specular[m] = 0.0
        grad_response_diffuse[m] = 0.0
        grad_visibility[m] = wp.vec3()
        grad_ambient_occlusion[m] = 0.0
        cells[m, 0] = cell_count(size)
        return

    # forward again: E_d(n)
    tau = response_diffuse[m]
    point = find_face(n)
    cell = footprint(point, size)
    texels = read_cell(irradiance_map, 0, cell, size)
    irradiance = blend_cell(cell, texels)
    bounced = bounces(albedo[m], ambient_occlusion[m])
    arriving = wp.cw_mul(visibility[m], irradiance)
    l_d = tau * wp.cw_mul(bounced, arriving)

    # adjoint: from C_fg and L_d to what arrives, and to E_d
    grad_l_d = grad_irradiance[m] + (1.0 - specular[m]) * wp.cw_mul(albedo[m], grad_radiance[m])
    grad_arriving = tau * wp.cw_mul(bounced, grad_l_d)
    grad_e_d = wp.cw_mul(visibility[m], grad_arriving)

    # to the channels; with b = 1 / (1 - a (1 - o)), db/da = b^2 (1 - o) and db/do = -b^2 a
    grad_share = wp.cw_mul(wp.cw_mul(bounced, l_d), grad_l_d)
    grad_albedo[m] = (1.0 - specular[m]) * wp.cw_mul(l_d, grad_radiance[m]) + (
        1.0 - ambient_occlusion[m]
    ) * grad_share
    grad_specular[m] = -wp.dot(albedo[m], wp.cw_mul(l_d, grad_radiance[m]))
    grad_response_diffuse[m] = wp.dot(wp.cw_mul(bounced, arriving), grad_l_d)
    grad_visibility[m] = wp.cw_mul(irradiance, grad_arriving)
    grad_ambient_occlusion[m] = -wp.dot(albedo[m], grad_share)
    slope = 0.5 * wp.float32(size) * cell_slope(cell, texels, grad_e_d)
    grad_normal[m] = find_face_adjoint(n, point, slope[0], slope[1])

    # to the map
    grad_lookup[m] = grad_e_d
    cells[m, 0] = cell_index(cell, size)
    places[m, 0] = wp.vec3(cell.x, cell.y, 1.0)


@wp.struct
class _Lookup:
    """A trilinear lookup again: its value E_s, and the gradients of its place on the face and its level."""

    light: wp.vec3
    slope: wp.vec2
    grad_level: wp.float32


@wp.func
def _look_up_again(
    mips: wp.array[wp.vec3],
    table: wp.array2d[wp.int32],
    point: FacePoint,
    level: wp.float32,
    grad_value: wp.vec3,
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
        result.slope += 0.5 * wp.float32(size) * share * cell_slope(cell, texels, grad_value)
        result.grad_level += wp.where(slot == 0, -1.0, 1.0) * wp.dot(value, grad_value)
        cells[m, slot] = table[lower + slot, 2] + cell_index(cell, size)
        places[m, slot] = wp.vec3(cell.x, cell.y, share)
    return result


@wp.kernel(enable_backward=False)
def _specular_adjoint(
    first: wp.int32,
    normal: wp.array[wp.vec3],
    roughness: wp.array[wp.float32],
    specular: wp.array[wp.float32],
    response_specular: wp.array[wp.float32],
    visibility_specular: wp.array[wp.float32],
    view: wp.array[wp.vec3],
    alpha: wp.array[wp.float32],
    mips: wp.array[wp.vec3],
    brdf: wp.array2d[wp.vec2],
    table: wp.array2d[wp.int32],
    grad_radiance: wp.array[wp.vec3],
    grad_specular_light: wp.array[wp.vec3],
    grad_normal: wp.array[wp.vec3],
    grad_roughness: wp.array[wp.float32],
    grad_specular: wp.array[wp.float32],
    grad_response_specular: wp.array[wp.float32],
    grad_visibility_specular: wp.array[wp.float32],
    grad_view: wp.array[wp.vec3],
    grad_lookup: wp.array[wp.vec3],
    cells: wp.array2d[wp.int32],
    places: wp.array2d[wp.vec3],
) -> None:
    """Adjoint of C_fg = ... + L_s (f B_x + B_y), L_s = tau_s v_s E_s(r, rho).

    ``grad_specular_light`` is what came to L_s itself. The gradients of normal and f are added to what
    `_diffuse_adjoint` left there; the others are written.
    """
    m = first + wp.tid()
    n = normal[m]
    v = view[m]
    f = specular[m]
    levels = table.shape[0]
    if not is_lit(alpha[m], n):
        grad_roughness[m] = 0.0
        grad_response_specular[m] = 0.0
        grad_visibility_specular[m] = 0.0
        grad_view[m] = wp.vec3()
        for slot in range(cells.shape[1]):
            cells[m, slot] = table[levels - 1, 2] + cell_count(table[levels - 1, 0])
        return

    # forward again: B_x and B_y, which weigh the gradient that the light gets
    tau = response_specular[m] * visibility_specular[m]
    cosine = wp.dot(n, v)
    place = find_brdf(roughness[m], cosine, brdf.shape[0])
    b = read_brdf(brdf, place)

    # adjoint: from C_fg and L_s to E_s
    grad_l_s = grad_specular_light[m] + (f * b[0] + b[1]) * grad_radiance[m]
    grad_e_s = tau * grad_l_s

    # through the lookup, whose value comes along; this notes the gradient of the mips
    r = 2.0 * cosine * n - v
    point = find_face(r)
    level = roughness[m] * wp.float32(levels - 1)
    seen = _look_up_again(mips, table, point, level, grad_e_s, m, cells, places)
    light = seen.light
    grad_r = find_face_adjoint(r, point, seen.slope[0], seen.slope[1])
    grad_lookup[m] = grad_e_s

    # through the factor f B_x + B_y, and through r, to n . v
    grad_factor = tau * wp.dot(light, grad_radiance[m])
    grad_b = wp.vec2(f * grad_factor, grad_factor)
    grad_cosine = wp.dot(brdf_slope_cosine(brdf, place), grad_b) + 2.0 * wp.dot(grad_r, n)

    # to the channels and the view
    grad_roughness[m] = wp.dot(brdf_slope_roughness(brdf, place), grad_b)
    if level_moves(level, levels):
        grad_roughness[m] += wp.float32(levels - 1) * seen.grad_level
    grad_specular[m] += b[0] * grad_factor
    grad_response_specular[m] = visibility_specular[m] * wp.dot(light, grad_l_s)
    grad_visibility_specular[m] = response_specular[m] * wp.dot(light, grad_l_s)
    grad_normal[m] += 2.0 * cosine * grad_r + grad_cosine * v
    grad_view[m] = grad_cosine * n - grad_r
