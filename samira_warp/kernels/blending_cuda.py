"""Blending on a GPU: a thread per pixel forward, and a cooperative block of 256 threads per tile backward.

Forward, neighbouring threads are neighbours in a tile and read the same records, which the cache broadcasts; channels go in chunks of
LANES that stay in registers. Backward, the block walks its tile's list together: every thread computes its pixel's share of a Gaussian's
gradient, one block-wide reduction sums them, and the sum is stored in the slot, so nothing is added atomically and every run gives the
same bits. Both walk the list front to back with the same arithmetic, so both cut and stop at the same places.

`wp.config.enable_cpu_blocks` runs the cooperative kernel on a CPU: slow, but it is how the tests check it where there is no GPU.
"""

from __future__ import annotations

import math

import torch
import warp as wp
from torch import Tensor

from samira_warp.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from samira_warp.kernels.runtime import launch
from samira_warp.kernels.splats import RECORD, Octet
from samira_warp.kernels.tiles import TILE, TileBins

LANES = 16
"""Channels are padded with zeros to a multiple of this: a chunk of channels lives in registers."""

BLOCK = TILE * TILE
VOTE = 32
"""Gaussians between two votes on whether every pixel of the tile has stopped."""

Chunk = wp.types.vector(length=LANES, dtype=wp.float32)


def forward(splats: Tensor, bins: TileBins, channels: int, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Features (H, W, C) and transmittance (H, W) from splat records padded to LANES."""
    padded = splats.shape[1] - RECORD
    features, transmittance = splats.new_zeros(height, width, padded), splats.new_ones(height, width)
    threads = (padded // LANES, bins.columns * bins.rows * BLOCK)
    launch(_blend_pixel, threads, splats, bins.columns, bins.tile_offsets, bins.gaussians, features, transmittance)
    return features[:, :, :channels].contiguous(), transmittance


def adjoint(
    splats: Tensor, bins: TileBins, features: Tensor, transmittance: Tensor, grad_features: Tensor, grad_transmittance: Tensor
) -> Tensor:
    """Gradients by slot, (I, 1 + C / 8, 8) as of `splats.Octet`, from what `forward` took and gave."""
    channels = features.shape[2]
    padded = splats.shape[1] - RECORD
    grad_padded = torch.nn.functional.pad(grad_features, (0, padded - channels))
    # the sum still to come behind the first Gaussian, the background's share included
    behind = (features * grad_features).sum(dim=-1) + transmittance * grad_transmittance
    slot_gradients = splats.new_zeros(bins.slots.shape[0], 1 + padded // 8, 8)
    lists = (bins.tile_offsets, bins.gaussians, bins.slots)
    arguments = (splats, bins.columns, *lists, grad_padded, behind, slot_gradients)
    launch(_blend_block_adjoint, bins.columns * bins.rows * BLOCK, *arguments, block_dim=BLOCK)
    return slot_gradients[:, : 1 + -(-channels // 8)].contiguous()


@wp.func
def _density(splats: wp.array2d[wp.float32], i: wp.int32, d: wp.vec2) -> wp.float32:
    """Opacity * exp(-sigma) at the offset d from the mean of Gaussian i; 0 outside the ellipse where alpha counts."""
    along = splats[i, 2] * d[0] + splats[i, 3] * d[1]
    quadratic = along * along + splats[i, 4] * d[1] * d[1]
    # the cut has a margin: it saves the exponential, the threshold on alpha decides
    if quadratic > splats[i, 6]:
        return 0.0
    return wp.exp((splats[i, 5] - quadratic) * wp.static(math.log(2.0)))


@wp.func
def _alpha(density: wp.float32) -> wp.float32:
    """Density capped at ALPHA_MAX, and 0 below ALPHA_MIN."""
    if density < wp.static(ALPHA_MIN):
        return 0.0
    return wp.min(density, wp.static(ALPHA_MAX))


@wp.func
def _pixel(thread: wp.int32, columns: wp.int32) -> wp.vec3i:
    """Tile, x and y of a thread."""
    tile, lane = thread / BLOCK, thread % BLOCK
    return wp.vec3i(tile, (tile % columns) * TILE + lane % TILE, (tile / columns) * TILE + lane / TILE)


@wp.kernel(enable_backward=False)
def _blend_pixel(
    splats: wp.array2d[wp.float32],
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    gaussians: wp.array[wp.int32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None:
    """One pixel of one chunk of channels."""
    chunk, thread = wp.tid()
    place = _pixel(thread, columns)
    x, y = place[1], place[2]
    if x >= features.shape[1] or y >= features.shape[0]:
        return
    center = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    total = Chunk()
    T = wp.float32(1.0)
    for entry in range(tile_offsets[place[0]], tile_offsets[place[0] + 1]):
        i = gaussians[entry]
        alpha = _alpha(_density(splats, i, center - wp.vec2(splats[i, 0], splats[i, 1])))
        if alpha == 0.0:
            continue
        weight = alpha * T
        if T - weight < wp.static(TRANSMITTANCE_MIN):
            break
        for c in range(LANES):
            total[c] += weight * splats[i, RECORD + chunk * LANES + c]
        T -= weight
    for c in range(LANES):
        features[y, x, chunk * LANES + c] = total[c]
    if chunk == 0:
        transmittance[y, x] = T


@wp.func
def _geometry_gradient(splats: wp.array2d[wp.float32], i: wp.int32, d: wp.vec2, grad_sigma: wp.float32) -> Octet:
    """Gradient of mean x, y; conic xx, xy, yy; opacity, from that of sigma at the offset d."""
    root, shear, rest = splats[i, 2], splats[i, 3], splats[i, 4]
    scale = wp.static(2.0 * math.log(2.0))
    A, B, C = scale * root * root, scale * root * shear, scale * (shear * shear + rest)
    gradient = Octet()
    gradient[0] = -(A * d[0] + B * d[1])
    gradient[1] = -(B * d[0] + C * d[1])
    gradient[2] = 0.5 * d[0] * d[0]
    gradient[3] = d[0] * d[1]
    gradient[4] = 0.5 * d[1] * d[1]
    gradient[5] = -splats[i, 7]
    return grad_sigma * gradient


@wp.kernel(enable_backward=False)
def _blend_block_adjoint(
    splats: wp.array2d[wp.float32],
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    gaussians: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    grad_features: wp.array3d[wp.float32],
    behind_all: wp.array2d[wp.float32],
    slot_gradients: wp.array2d[Octet],
) -> None:
    """One tile: its 256 threads are its pixels, and meet at every Gaussian to sum their shares."""
    thread = wp.tid()
    place = _pixel(thread, columns)
    x, y = place[1], place[2]
    center = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    T = wp.float32(0.0)
    behind = wp.float32(0.0)
    if x < grad_features.shape[1] and y < grad_features.shape[0]:
        T = wp.float32(1.0)
        behind = behind_all[y, x]
    channels = grad_features.shape[2]
    start, end = tile_offsets[place[0]], tile_offsets[place[0] + 1]
    for entry in range(start, end):
        if (entry - start) % VOTE == 0:
            unfinished = wp.tile_max(wp.tile(T))
            if unfinished[0] == 0.0:
                break
        i = gaussians[entry]
        slot = slots[entry]
        d = center - wp.vec2(splats[i, 0], splats[i, 1])
        density = _density(splats, i, d)
        alpha = _alpha(density)
        weight = alpha * T
        # a stopped pixel, or one outside the image, has T = 0: it weighs nothing from here on, but keeps the block's pace
        if T - weight < wp.static(TRANSMITTANCE_MIN):
            weight = wp.float32(0.0)
            T = wp.float32(0.0)
        T -= weight

        grad_sigma = wp.float32(0.0)
        if weight > 0.0:
            dot = wp.float32(0.0)
            for c in range(channels):
                dot += splats[i, RECORD + c] * grad_features[y, x, c]
            behind -= weight * dot
            if density <= wp.static(ALPHA_MAX):
                grad_sigma = behind * alpha / (1.0 - alpha) - weight * dot
        geometry = wp.tile_reduce(wp.add, wp.tile(_geometry_gradient(splats, i, d, grad_sigma), preserve_type=True))
        if thread % BLOCK == 0:
            slot_gradients[slot, 0] = geometry[0]
        for chunk in range(channels / LANES):
            gradient = Chunk()
            if weight > 0.0:
                for c in range(LANES):
                    gradient[c] = weight * grad_features[y, x, chunk * LANES + c]
            total = wp.tile_reduce(wp.add, wp.tile(gradient, preserve_type=True))
            if thread % BLOCK == 0:
                for half in range(2):
                    octet = Octet()
                    for c in range(8):
                        octet[c] = total[0][half * 8 + c]
                    slot_gradients[slot, 1 + chunk * 2 + half] = octet
