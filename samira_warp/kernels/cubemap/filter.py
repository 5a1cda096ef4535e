"""Exact GGX prefiltering and cosine irradiance of cubemaps.

Every texel of the light weighs in every texel of the result: both are the sum over texels j of
L_j k(n_i . l_j) dOmega_j with exact solid angles. With view = normal = reflection, the half vector of the GGX
lobe is between normal and light, (n . h)^2 = (1 + n . l) / 2, so that with alpha = roughness^2

    k(c) = max(c, 0) D_GGX / D_GGX(1) = max(c, 0) alpha^4 / (alpha^2 + (1 - alpha^2) (1 - c) / 2)^2

and alpha = 1 leaves the cosine. The symmetries of the cube (`kernels.cubemap.symmetry`) turn the sum into
eight matrix products. Small filters, such as a training step's, keep the matrices; for large ones
`kernels.cubemap.filter_cpu` makes them within the product.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.cubemap.filter_cpu import sum_lobes
from samira_warp.kernels.cubemap.layout import FACES, check_cubemap, texel_directions, texel_solid_angles
from samira_warp.kernels.cubemap.symmetry import (
    OCTANTS,
    PERMUTATIONS,
    collect_table,
    parities,
    result_table,
    spread_table,
    symmetry,
)
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.caching import cached_tensors
from samira_warp.support.errors import UserError

_CACHED_WEIGHTS = 1 << 22
"""A filter of at most this many weights (16 MB) keeps them, as all of a training step's do; a larger one
makes them anew each time."""

_BLOCK_WEIGHTS = 1 << 21
"""Weights made at a time by a larger filter on a GPU: 8 MB, which stay in its cache between making and
use."""

_BLOCK_WIDTH = 4096
"""Texels of such a block."""

CHANNELS_MAX = 32
"""Channels of a map: `kernels.cubemap.filter_cpu` keeps the sums of all of them on a thread's stack, 12 KB a
channel."""


def irradiance(radiance: Tensor, *, size: int = 16) -> Tensor:
    """Cosine-weighted mean radiance: a uniform light of 1 gives 1.

    It is E_d(n) = (1 / pi) sum of L max(n . l, 0) dOmega.

    Args:
        radiance: (6, S, S, C) float32, linear; S even, C at most 32.
        size: Even size of the result.

    Returns:
        (6, size, size, C) float32, differentiable; linear in ``radiance``, with the exact adjoint.

    Raises:
        UserError: A wrong shape or dtype, too many channels, or an odd size.
    """
    _check("radiance", radiance, (size,))
    (result,) = _Filters.apply(radiance, (Lobe(size, alpha=1.0, normalised=False),))
    return result


def prefilter(base: Tensor, *, ladder: Sequence[tuple[float, int]]) -> tuple[Tensor, ...]:
    """The chain of mips of a light seen in ever rougher surfaces.

    First the base itself, then GGX-weighted means of it.

    Args:
        base: (6, S, S, C) float32, linear radiance; S even, C at most 32.
        ladder: (roughness, size) of each further mip: roughness in (0, 1], size even.

    Returns:
        1 + len(ladder) mips, (6, S, S, C) and (6, size, size, C) float32, differentiable; each linear in
        ``base``, with the exact adjoint.

    Raises:
        UserError: A wrong shape or dtype, too many channels, an odd size, or a roughness out of range.
    """
    _check("base", base, [size for _, size in ladder])
    for roughness, _ in ladder:
        if not 0 < roughness <= 1:
            raise UserError("ladder", expected="roughness in (0, 1]", found=roughness)
    lobes = tuple(Lobe(size, alpha=roughness * roughness, normalised=True) for roughness, size in ladder)
    return (base, *_Filters.apply(base, lobes))


class Lobe(NamedTuple):
    """A filter: its result's size, its width, and whether its weights are divided by their sum or by pi."""

    size: int
    alpha: float
    normalised: bool


class _Filters(torch.autograd.Function):
    """Several filters of one map."""

    @staticmethod
    def forward(ctx: Any, base: Tensor, lobes: tuple[Lobe, ...]) -> tuple[Tensor, ...]:
        parts = _spread(base)
        results, scales = [], []
        for lobe in lobes:
            # the sum over texels, for one representative of each orbit and all six turns of the map ...
            products, sums = _sum_over_texels(parts, base.shape[1], lobe)
            scale = 1.0 / sums if lobe.normalised else torch.full_like(sums, 1.0 / torch.pi)
            scales.append(scale)
            # ... which are the results at the places where the turns carry the representative
            products = (products * scale).transpose(1, 2).reshape(-1, base.shape[-1])
            results.append(
                _from_parities(products[result_table(lobe.size, base.device)], lobe.size) / OCTANTS
            )
        ctx.save_for_backward(*scales)
        ctx.base_size, ctx.lobes = base.shape[1], lobes
        return tuple(results)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_results: Tensor) -> tuple[Tensor | None, ...]:
        # the transposes of the forward pass's steps, last to first; what the lobes give the base adds up
        first, *_ = grad_results
        device, columns = first.device, len(PERMUTATIONS) * first.shape[-1]
        grad_parts = first.new_zeros(OCTANTS, columns, FACES * ctx.base_size**2 // OCTANTS)
        for lobe, scale, grad in zip(ctx.lobes, ctx.saved_tensors, grad_results, strict=True):
            grad_products = grad.new_zeros(OCTANTS * len(scale) * len(PERMUTATIONS), grad.shape[-1])
            # no row of the products was read twice, so this copies and never adds
            grad_products[result_table(lobe.size, device)] = _to_parities(grad) / OCTANTS
            grad_products = grad_products.view(OCTANTS, -1, columns) * scale[:, None]
            grad_products = grad_products.transpose(1, 2).contiguous()
            grad_parts += _sum_over_results(grad_products, ctx.base_size, lobe)
        return _collect(grad_parts, ctx.base_size), None


def _spread(cubemap: Tensor) -> Tensor:
    """(8, 6 C, U): the parity parts of a cubemap (6, S, S, C) in all six turns, texels last.

    Skinny matrix products are half as fast again with the long axis last.
    """
    octants = _to_parities(cubemap)
    turned = octants.view(-1, cubemap.shape[-1])[spread_table(cubemap.shape[1], cubemap.device)]
    return turned.view(*octants.shape[:2], -1).transpose(1, 2).contiguous()


def _collect(parts: Tensor, size: int) -> Tensor:
    """(6, S, S, C) transpose of `_spread`."""
    channels = parts.shape[1] // len(PERMUTATIONS)
    rows = parts.transpose(1, 2).reshape(-1, channels)[collect_table(size, parts.device)].sum(dim=1)
    return _from_parities(rows.view(OCTANTS, -1, channels), size)


def _to_parities(cubemap: Tensor) -> Tensor:
    """(8, U, C) even and odd parts of a cubemap (6, S, S, C)."""
    octants = cubemap.reshape(-1, cubemap.shape[-1])[symmetry(cubemap.shape[1], cubemap.device).flips]
    return (parities(cubemap.device) @ octants.view(OCTANTS, -1)).view_as(octants)


def _from_parities(parts: Tensor, size: int) -> Tensor:
    """(6, S, S, C) transpose of `_to_parities`, which is 8 times its inverse."""
    octants = (parities(parts.device) @ parts.reshape(OCTANTS, -1)).view_as(parts)
    result = torch.empty_like(octants).view(-1, parts.shape[-1])
    result[symmetry(size, parts.device).flips] = octants
    return result.view(FACES, size, size, -1)


def _sum_over_texels(parts: Tensor, base_size: int, lobe: Lobe) -> tuple[Tensor, Tensor]:
    """Products of the base's parity parts with a filter's eight matrices, and the sums of its weights.

    Args:
        parts: (8, 6 C, U) parity parts of the base.
        base_size: S of the base.
        lobe: The filter.

    Returns:
        (8, 6 C, R) products and (R,) sums.
    """
    device = parts.device
    if _is_fused(base_size, lobe, device):
        return sum_lobes(_representatives(lobe.size, device), _octant(base_size, device), parts, lobe.alpha)
    rows = len(symmetry(lobe.size, device).representatives)
    products, sums = parts.new_zeros(OCTANTS, parts.shape[1], rows), parts.new_zeros(rows)
    for block, texels, weights in _weights(base_size, lobe, device):
        products[..., block] += parts[..., texels] @ weights.transpose(1, 2)
        # the even parity of a row is the sum over the octants
        sums[block] += weights[0].sum(dim=1)
    return products, sums


def _sum_over_results(products: Tensor, base_size: int, lobe: Lobe) -> Tensor:
    """(8, 6 C, U) transpose of `_sum_over_texels`, of (8, 6 C, R)."""
    device = products.device
    octant = _octant(base_size, device)
    if _is_fused(base_size, lobe, device):
        *_, areas = octant
        sums, _ = sum_lobes(octant, _representatives(lobe.size, device), products, lobe.alpha)
        return areas * sums
    parts = products.new_zeros(*products.shape[:2], octant.shape[1])
    for block, texels, weights in _weights(base_size, lobe, device):
        parts[..., texels] += products[..., block] @ weights
    return parts


def _is_fused(base_size: int, lobe: Lobe, device: torch.device) -> bool:
    """Whether a filter's weights are better made within its sums: too many to keep, and on a slow memory."""
    return device.type == "cpu" and _weight_count(base_size, lobe, device) > _CACHED_WEIGHTS


def _weight_count(base_size: int, lobe: Lobe, device: torch.device) -> int:
    return FACES * base_size**2 * len(symmetry(lobe.size, device).representatives)


def _weights(base_size: int, lobe: Lobe, device: torch.device) -> Iterator[tuple[slice, slice, Tensor]]:
    """Blocks (rows, texels, (8, rows, texels) weights) of a filter's eight matrices, not normalised."""
    rows = len(symmetry(lobe.size, device).representatives)
    texels = FACES * base_size * base_size // OCTANTS
    if _weight_count(base_size, lobe, device) <= _CACHED_WEIGHTS:
        yield slice(0, rows), slice(0, texels), _stored_weights(base_size, lobe.size, lobe.alpha, device)
        return
    width = min(texels, _BLOCK_WIDTH)
    height = max(1, _BLOCK_WEIGHTS // (OCTANTS * width))
    for first_row in range(0, rows, height):
        for first_texel in range(0, texels, width):
            block = (
                slice(first_row, min(first_row + height, rows)),
                slice(first_texel, min(first_texel + width, texels)),
            )
            yield *block, _make_weights(base_size, lobe.size, lobe.alpha, *block, device)


@cached_tensors(maxsize=16)
def _stored_weights(base_size: int, size: int, alpha: float, device: torch.device) -> Tensor:
    rows, texels = len(symmetry(size, device).representatives), FACES * base_size * base_size // OCTANTS
    return _make_weights(base_size, size, alpha, slice(0, rows), slice(0, texels), device)


def _make_weights(
    base_size: int, size: int, alpha: float, rows: slice, texels: slice, device: torch.device
) -> Tensor:
    """(8, rows, texels) weights of one block of the eight matrices."""
    height, width = rows.stop - rows.start, texels.stop - texels.start
    weights = torch.empty(OCTANTS, height, width, device=device)
    # on the CPU a thread's inner loop is vectorised over a row's texels; on a GPU neighbouring threads take
    # neighbouring texels
    run = 1 if device.type == "cuda" else width
    *axes, _ = _representatives(size, device)
    normals, octant = torch.stack(axes, dim=1), _octant(base_size, device)
    block = (alpha * alpha, rows.start, texels.start, run)
    launch_range(_lobe_parities, height * (width // run), normals, octant, *block, weights)
    return weights


@cached_tensors(maxsize=16)
def _representatives(size: int, device: torch.device) -> Tensor:
    """(4, R): x, y and z of the directions of the representatives, and ones."""
    tables = symmetry(size, device)
    directions = texel_directions(size, device=device).view(-1, 3)[tables.flips[0][tables.representatives]]
    return torch.cat([directions, torch.ones_like(directions[:, :1])], dim=-1).T.contiguous()


@cached_tensors(maxsize=16)
def _octant(size: int, device: torch.device) -> Tensor:
    """(4, U): x, y and z of the directions, and the solid angles, of the texels of the positive octant."""
    areas = texel_solid_angles(size, device=device).expand(FACES, size, size)
    values = torch.cat([texel_directions(size, device=device), areas[..., None]], dim=-1).view(-1, 4)
    return values[symmetry(size, device).flips[0]].T.contiguous()


_LOBE_RUN = """
    const float* x = octant.data + texel;
    const float* y = x + octant.shape[1];
    const float* z = y + octant.shape[1];
    const float* area = z + octant.shape[1];
    const int plane = weights.shape[1] * weights.shape[2];
    float* __restrict__ out = weights.data + place;
    const float slope = 0.25f * (1.0f - alpha_squared);
    for (int i = 0; i < run; ++i) {
        // ---- The lobe's eight values: squared distances along each axis, as it is and flipped.
        const float dx[2] = {
            (normal[0] - x[i]) * (normal[0] - x[i]), (normal[0] + x[i]) * (normal[0] + x[i])};
        const float dy[2] = {
            (normal[1] - y[i]) * (normal[1] - y[i]), (normal[1] + y[i]) * (normal[1] + y[i])};
        const float dz[2] = {
            (normal[2] - z[i]) * (normal[2] - z[i]), (normal[2] + z[i]) * (normal[2] + z[i])};
        float w[8];
        #pragma unroll
        for (int f = 0; f < 8; ++f) {
            const float distance = dx[f & 1] + dy[f >> 1 & 1] + dz[f >> 2];
            const float falloff = alpha_squared / (alpha_squared + slope * distance);
            const float cosine = 1.0f - 0.5f * distance;
            w[f] = area[i] * (cosine > 0.0f ? cosine : 0.0f) * falloff * falloff;
        }
        // ---- Their parities: three rounds of butterflies, in place.
        #pragma unroll
        for (int bit = 1; bit < 8; bit *= 2) {
            #pragma unroll
            for (int f = 0; f < 8; ++f) {
                if (f & bit) continue;
                const float a = w[f], b = w[f | bit];
                w[f] = a + b;
                w[f | bit] = a - b;
            }
        }
        #pragma unroll
        for (int p = 0; p < 8; ++p) out[p * plane + i] = w[p];
    }
"""
"""k(c) of this file's head for the eight flips of each texel in a run, and their fast Walsh-Hadamard
transform.

It is native because only then does LLVM vectorise the loop, which makes it twenty times as fast;
`reference.cubemap.filter` specifies it. 1 - c is half the squared distance of the unit vectors, which does
not cancel where the lobe is narrow.
"""


@wp.func_native(_LOBE_RUN)
def _lobe_run(
    normal: wp.vec3,
    octant: wp.array2d[wp.float32],
    alpha_squared: wp.float32,
    texel: wp.int32,
    run: wp.int32,
    place: wp.int32,
    weights: wp.array3d[wp.float32],
) -> None: ...


@wp.kernel(enable_backward=False)
def _lobe_parities(
    first: wp.int32,
    normals: wp.array[wp.vec3],
    octant: wp.array2d[wp.float32],
    alpha_squared: wp.float32,
    first_row: wp.int32,
    first_texel: wp.int32,
    run: wp.int32,
    weights: wp.array3d[wp.float32],
) -> None:
    """The eight parities of the weights of one normal for a run of texels."""
    place = (first + wp.tid()) * run
    row = place // weights.shape[2]
    texel = first_texel + place % weights.shape[2]
    _lobe_run(normals[first_row + row], octant, alpha_squared, texel, run, place, weights)


def _check(name: str, cubemap: Tensor, sizes: Sequence[int]) -> None:
    check_cubemap(name, cubemap)
    if cubemap.shape[3] > CHANNELS_MAX:
        raise UserError(name, expected=f"at most {CHANNELS_MAX} channels", found=cubemap.shape[3])
    for size in (cubemap.shape[1], *sizes):
        if size < 2 or size % 2:
            raise UserError("cubemap size", expected="an even number", found=size)
