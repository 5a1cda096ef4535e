"""Blending on a GPU: a block of four warps per tile.

Each warp has an 8 x 8 square of the tile in two halves of 8 x 4 pixels, one per lane. The bodies are native
snippets, since Warp has no words for a warp inside a block. `samira_warp/kernels/plain/blending.py` says the
same one pixel at a time in Warp. The mathematics is that of `samira_warp.kernels.raster.blending`; the
arrangement is:

- A block copies its tile's records to shared memory batch by batch, the next while it works on one. A warp
  tests a batch against both its halves, lane k the k-th Gaussian, and visits only those whose ellipse meets
  one: the others cost it nothing.
- Every channel of a pixel lives in a register: there are kernels for several numbers of channels. More than
  the largest are blended group by group, as images of their own; a gradient is a sum over channels, so those
  of the geometry add up.
- Backward, a lane sums its two pixels, then the warp its lanes: in each of five steps a lane keeps one half
  of the values and gives the other to its partner, so n values cost about n exchanges rather than 5 n. Warps
  leave their sums in shared memory, and the block adds a batch's in the order of the warps and stores its
  slots. Nothing is added atomically: every run gives the same bits.
- Both directions walk the list front to back and round alike, so both cut and stop at the same places. The
  block stops when its pixels have: slots behind that are not reached.

The tests run these kernels on a CPU, fiber by fiber: see `blending_cuda_warp`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.blending_cuda_warp import BLOCK, COLLECTIVES
from samira_warp.kernels.raster.slots import GEOMETRY, SlotGradients
from samira_warp.kernels.raster.splats import RECORD
from samira_warp.kernels.raster.tiles import TileBins
from samira_warp.kernels.runtime import launch
from samira_warp.support.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

LANES = 4
"""Channels are padded with zeros to a multiple of this: a GPU loads four floats at a time."""

BATCH = 32
"""Gaussians that a block has in shared memory at a time: one for every lane to test."""

GROUPS = (4, 8, 12, 16, 32)
"""Channels that a forward kernel keeps in registers; the least that is enough is taken."""

ADJOINT_GROUPS = GROUPS[:-1]
"""The same backward, where a channel takes twice the registers."""

ADJOINT_BLOCKS = 5
"""Blocks that a multiprocessor has to hold at a time: 96 registers per thread, which up to 12 channels are
met without spilling."""

_CONSTANTS = f"""
    constexpr float ALPHA_MAX = {ALPHA_MAX!r}f, ALPHA_MIN = {ALPHA_MIN!r}f;
    constexpr float TRANSMITTANCE_MIN = {TRANSMITTANCE_MIN!r}f;
    constexpr float LN2 = {math.log(2.0)!r}f;
    constexpr int RECORD = {RECORD}, GEOMETRY = {GEOMETRY}, BATCH = {BATCH};
"""

_TILE = r"""
    constexpr int CHANNELS = sizeof(group) / sizeof(float);
    struct alignas(16) Quad { float x, y, z, w; };
    struct alignas(16) Splat {
        float mean_x, mean_y, root, shear, rest, level, cut, inverse_opacity, feature[CHANNELS];
    };
    constexpr int QUADS = sizeof(Splat) / sizeof(Quad);

    // ---- The block's tile, and the lane's two pixels in it.
    const int start = tile_offsets.data[tile], end = tile_offsets.data[tile + 1];
    const int height = features.shape[0], width = features.shape[1], channels = features.shape[2];
    // a lane's pixels are (x, y) and (x, y + 4)
    const int left = 16 * (tile % columns) + 8 * (warp % 2), top = 16 * (tile / columns) + 8 * (warp / 2);
    const int x = left + lane % 8, y = top + lane / 8;
    const float center_x = x + 0.5f, center_y = y + 0.5f;
    bool running[2] = {x < width && y < height, x < width && y + 4 < height};
    float T[2] = {1.0f, 1.0f};

    // ---- The batch: four neighbouring threads copy a record, four floats each in turn. The index of the
    // one that comes next is read a batch ahead.
    constexpr int COPIERS = BLOCK / BATCH;
    const int staged = thread / COPIERS, first_quad = first_channel / 4;
    int next_gaussian = start + staged < end ? records.data[start + staged] : 0;
    auto fetch_batch = [&](Splat* batch, int begin) {
        const int row = splats.shape[1] / 4;
        const Quad* record = (const Quad*)splats.data + (size_t)next_gaussian * row;
        Quad* place = (Quad*)(batch + staged);
        #pragma unroll
        for (int step = 0; step < QUADS; step += COPIERS) {
            const int q = thread % COPIERS + step, source = q < RECORD / 4 ? q : q + first_quad;
            if (begin + staged >= end || q >= QUADS) continue;
            if (source < row) copy(place + q, record + source);
            else place[q] = Quad{0.0f, 0.0f, 0.0f, 0.0f};
        }
        if (begin + BATCH + staged < end) next_gaussian = records.data[begin + BATCH + staged];
    };

    // ---- Which of its Gaussians a warp visits.
    // (root dx + shear dy)^2 + rest dy^2; fmaf leaves the compiler no choice of rounding, so forward and
    // backward agree
    auto quadratic = [](const Splat& s, float dx, float dy) {
        const float along = fmaf(s.root, dx, s.shear * dy);
        return fmaf(along, along, s.rest * dy * dy);
    };
    auto clamp = [&](float value, float low, float high) { return least(greatest(value, low), high); };
    // Whether the ellipse meets the 8 x 4 pixel centres below row: the form is least at the mean, or on an
    // edge that faces it, where it is a parabola. Both candidates are points of the rectangle, so no case is
    // needed. The slack covers rounding.
    auto touches = [&](const Splat& s, int row) {
        const float low_x = left + 0.5f - s.mean_x, high_x = low_x + 7.0f;
        const float low_y = row + 0.5f - s.mean_y, high_y = low_y + 3.0f;
        const float dx = clamp(0.0f, low_x, high_x), dy = clamp(0.0f, low_y, high_y);
        const float beside =
            clamp(-s.root * s.shear * dx * reciprocal(s.shear * s.shear + s.rest), low_y, high_y);
        const float below = clamp(-s.shear * dy * reciprocal(s.root), low_x, high_x);
        return !(least(quadratic(s, dx, beside), quadratic(s, below, dy)) > 1.001f * s.cut + 0.01f);
    };
    // bits of the batch's Gaussians that a half has to visit
    auto touched_by = [&](const Splat* batch, int size, int half) {
        const unsigned touched = ballot(lane < size && touches(batch[lane], top + 4 * half));
        return ballot(running[half]) ? touched : 0u;
    };

    // ---- One Gaussian at one pixel.
    // What a Gaussian's density leaves of the transmittance; false where it does not show. A pixel that it
    // would end stops before it.
    auto meet = [&](float density, int half, float& alpha, float& next) {
        if (!(running[half] && density >= ALPHA_MIN)) return false;
        alpha = least(density, ALPHA_MAX);
        next = fmaf(-alpha, T[half], T[half]);
        running[half] = next >= TRANSMITTANCE_MIN;
        return running[half];
    };
"""

_FORWARD = r"""
    // ---- The forward pass: while the block works on one batch, the next is on its way.
    struct Shared { Splat batch[2][BATCH]; };
    BLOCK_SHARED(Shared, shared)

    float sum[2][CHANNELS] = {};
    fetch_batch(shared.batch[0], start);
    for (int begin = start; begin < end; begin += BATCH) {
        const int which = (begin - start) / BATCH % 2;
        const int size = end - begin < BATCH ? end - begin : BATCH;
        const Splat* batch = shared.batch[which];
        wait_for_copies();
        if (!block_any(running[0] || running[1])) break;
        fetch_batch(shared.batch[1 - which], begin + BATCH);
        const unsigned touched[2] = {touched_by(batch, size, 0), touched_by(batch, size, 1)};
        for (unsigned todo = touched[0] | touched[1]; todo; todo &= todo - 1) {
            const int j = lowest_bit(todo);
            const Splat& splat = batch[j];
            const float dx = center_x - splat.mean_x;
            #pragma unroll
            for (int half = 0; half < 2; ++half) {
                if (!(touched[half] >> j & 1)) continue;
                const float dy = center_y + 4.0f * half - splat.mean_y;
                float alpha, next;
                if (!meet(power_of_two(splat.level - quadratic(splat, dx, dy)), half, alpha, next)) continue;
                const float weight = alpha * T[half];
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c)
                    sum[half][c] = fmaf(weight, splat.feature[c], sum[half][c]);
                T[half] = next;
            }
        }
    }

    // ---- The pixels.
    #pragma unroll
    for (int half = 0; half < 2; ++half) {
        if (x >= width || y + 4 * half >= height) continue;
        const size_t pixel = (size_t)(y + 4 * half) * width + x;
        transmittance.data[pixel] = T[half];
        #pragma unroll
        for (int c = 0; c < CHANNELS; ++c)
            if (first_channel + c < channels)
                features.data[pixel * channels + first_channel + c] = sum[half][c];
    }
"""

_BACKWARD = r"""
    // the gradient of sigma times dx, dy, dx^2, dx dy, dy^2, 1; then the features' gradients
    constexpr int VALUES = GEOMETRY + CHANNELS;
    struct Shared { Splat batch[2][BATCH]; float sums[WARPS][BATCH][VALUES]; unsigned met[WARPS]; };
    BLOCK_SHARED(Shared, shared)

    // ---- The output's gradient, and what of it lies behind.
    float grad[2][CHANNELS] = {}, behind[2] = {};
    #pragma unroll
    for (int half = 0; half < 2; ++half) {
        if (!running[half]) continue;
        const size_t pixel = (size_t)(y + 4 * half) * width + x;
        // the sum still to come: this group's share, and the background's once
        if (first_channel == 0) behind[half] = transmittance.data[pixel] * grad_transmittance.data[pixel];
        #pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            if (first_channel + c >= channels) continue;
            grad[half][c] = grad_features.data[pixel * channels + first_channel + c];
            const float feature = features.data[pixel * channels + first_channel + c];
            behind[half] = fmaf(feature, grad[half][c], behind[half]);
        }
    }

    // ---- The reduction over a warp's lanes: of its values a lane keeps the lower or the upper half (of an
    // odd number, with a zero), five times. What is left in value[0] is the sum of value[owned], or of zeros
    // where that is -1.
    static_assert(VALUES <= 32, "a lane keeps one sum");
    auto sum_over_warp = [&](float* value) {
        int n = VALUES;
        #pragma unroll
        for (int step = 0; step < 5; ++step) {
            const int kept = (n + 1) / 2, across = 16 >> step;
            const bool upper = lane & across;
            #pragma unroll
            for (int i = 0; i < (VALUES + 1) / 2; ++i) {   // a known bound: the values stay in registers
                if (i >= kept) continue;
                const float low = value[i], high = i + kept < n ? value[i + kept] : 0.0f;
                value[i] = (upper ? high : low) + exchange(upper ? low : high, across);
            }
            n = kept;
        }
    };
    int owned = 0;
    for (int step = 4; step >= 0; --step) {
        const int given = (VALUES + (1 << step) - 1) >> step, kept = (given + 1) / 2;
        if (owned >= 0 && (lane & (16 >> step))) owned += kept;
        if (owned >= given) owned = -1;
    }

    // ---- The reduction over the block's warps, and the slots in which it ends.
    // A value of a slot: the sum over the warps that met Gaussian j, in their order; for the geometry turned
    // from moments into gradients.
    auto slot_value = [&](const Splat& s, int j, int k) {
        auto total = [&](int index) {
            float sum = 0.0f;
            for (int w = 0; w < WARPS; ++w)
                if (shared.met[w] >> j & 1) sum += shared.sums[w][j][index];
            return sum;
        };
        const float factor = 2.0f * LN2, B = factor * s.root * s.shear;
        if (k == 0) return -(factor * s.root * s.root * total(0) + B * total(1));
        if (k == 1) return -(B * total(0) + factor * (s.shear * s.shear + s.rest) * total(1));
        if (k == 2 || k == 4) return 0.5f * total(k);
        if (k == 5) return -s.inverse_opacity * total(k);
        return total(k);
    };
    auto write_slot = [&](const Splat& s, int entry, int j, int k) {
        const int slot = slots.data[entry];
        float* value = grad_slots.data + (size_t)slot * grad_slots.shape[1] + k;
        if (k >= GEOMETRY) value[first_channel] = slot_value(s, j, k);
        else if (first_channel == 0) *value = slot_value(s, j, k);
        else *value += slot_value(s, j, k);   // the groups before have left theirs
        if (k == 0) reached.data[slot] = true;
    };

    // ---- The adjoint, front to back.
    fetch_batch(shared.batch[0], start);
    for (int begin = start; begin < end; begin += BATCH) {
        const int which = (begin - start) / BATCH % 2;
        const int size = end - begin < BATCH ? end - begin : BATCH;
        const Splat* batch = shared.batch[which];
        wait_for_copies();
        if (!block_any(running[0] || running[1])) break;
        fetch_batch(shared.batch[1 - which], begin + BATCH);
        const unsigned touched[2] = {touched_by(batch, size, 0), touched_by(batch, size, 1)};
        unsigned met = 0;
        for (unsigned todo = touched[0] | touched[1]; todo; todo &= todo - 1) {
            const int j = lowest_bit(todo);
            const Splat& splat = batch[j];
            const float dx = center_x - splat.mean_x;
            float value[VALUES] = {};
            bool weighs = false;
            #pragma unroll
            for (int half = 0; half < 2; ++half) {
                // the forward pass again, which stops at the same places
                if (!(touched[half] >> j & 1)) continue;
                const float dy = center_y + 4.0f * half - splat.mean_y;
                const float density = power_of_two(splat.level - quadratic(splat, dx, dy));
                float alpha, next;
                if (!meet(density, half, alpha, next)) continue;
                weighs = true;
                const float weight = alpha * T[half];
                T[half] = next;
                // the gradients of the features, and of the density
                float dot = 0.0f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    dot = fmaf(splat.feature[c], grad[half][c], dot);
                    value[GEOMETRY + c] = fmaf(weight, grad[half][c], value[GEOMETRY + c]);
                }
                behind[half] = fmaf(-weight, dot, behind[half]);
                // dL/dsigma = -alpha dL/dalpha, dL/dalpha = T dot - behind / (1 - alpha);
                // none through the cap
                if (density > ALPHA_MAX) continue;
                const float grad_sigma = fmaf(behind[half], alpha * reciprocal(1.0f - alpha), -weight * dot);
                const float x_share = grad_sigma * dx, y_share = grad_sigma * dy;
                value[0] += x_share;
                value[1] += y_share;
                value[2] = fmaf(x_share, dx, value[2]);
                value[3] = fmaf(x_share, dy, value[3]);
                value[4] = fmaf(y_share, dy, value[4]);
                value[5] += grad_sigma;
            }
            if (!ballot(weighs)) continue;
            met |= 1u << j;
            sum_over_warp(value);
            if (owned >= 0) shared.sums[warp][j][owned] = value[0];
        }
        if (lane == 0) shared.met[warp] = met;
        block_barrier();
        unsigned met_by_any = 0;
        for (int w = 0; w < WARPS; ++w) met_by_any |= shared.met[w];
        #pragma unroll 1
        for (int e = thread; e < size * VALUES; e += BLOCK) {
            const int j = e / VALUES, k = e % VALUES;
            if (met_by_any >> j & 1 && first_channel + k < GEOMETRY + channels)
                write_slot(batch[j], begin + j, j, k);
        }
    }
"""


def forward(splats: Tensor, bins: TileBins, channels: int, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Features (H, W, C) and transmittance (H, W) from splat records padded to LANES."""
    features, transmittance = splats.new_empty(height, width, channels), splats.new_empty(height, width)
    lists = (bins.tile_offsets, bins.records)
    for first, group in _groups(channels, GROUPS):
        arguments = (group(), first, bins.columns, *lists, splats, features, transmittance)
        launch(_BLEND[group], bins.columns * bins.rows * BLOCK, *arguments, block_dim=BLOCK)
    return features, transmittance


def adjoint(
    splats: Tensor,
    bins: TileBins,
    features: Tensor,
    transmittance: Tensor,
    grad_features: Tensor,
    grad_transmittance: Tensor,
) -> SlotGradients:
    """Gradients by slot from what `forward` took and gave."""
    channels = features.shape[2]
    grad_slots = SlotGradients.allocate(bins, channels)
    lists = (bins.tile_offsets, bins.records, bins.slots)
    images = (features, transmittance, grad_features, grad_transmittance)
    for first, group in _groups(channels, ADJOINT_GROUPS):
        arguments = (group(), first, bins.columns, *lists, splats, *images, *grad_slots)
        launch(_BLEND_ADJOINT[group], bins.columns * bins.rows * BLOCK, *arguments, block_dim=BLOCK)
    return grad_slots


def _groups(channels: int, sizes: tuple[int, ...]) -> Iterator[tuple[int, Any]]:
    """First channel and vector type of each group."""
    for first in range(0, channels, sizes[-1]):
        yield first, _VECTORS[next((size for size in sizes if size >= channels - first), sizes[-1])]


@wp.func_native(COLLECTIVES + _CONSTANTS + _TILE + _FORWARD)
def _blend_block(
    tile: wp.int32,
    group: Any,
    first_channel: wp.int32,
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None: ...


@wp.func_native(COLLECTIVES + _CONSTANTS + _TILE + _BACKWARD)
def _blend_block_adjoint(
    tile: wp.int32,
    group: Any,
    first_channel: wp.int32,
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
    grad_features: wp.array3d[wp.float32],
    grad_transmittance: wp.array2d[wp.float32],
    grad_slots: wp.array2d[wp.float32],
    reached: wp.array[wp.bool],
) -> None: ...


@wp.kernel(enable_backward=False, grid_stride=False)
def _blend(
    group: Any,
    first_channel: wp.int32,
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None:
    """One tile of a group of channels; the length of ``group`` says how many, its values nothing."""
    _blend_block(
        wp.tid() / BLOCK,
        group,
        first_channel,
        columns,
        tile_offsets,
        records,
        splats,
        features,
        transmittance,
    )


@wp.kernel(enable_backward=False, grid_stride=False, launch_bounds=(BLOCK, ADJOINT_BLOCKS))
def _blend_adjoint(
    group: Any,
    first_channel: wp.int32,
    columns: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    slots: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
    grad_features: wp.array3d[wp.float32],
    grad_transmittance: wp.array2d[wp.float32],
    grad_slots: wp.array2d[wp.float32],
    reached: wp.array[wp.bool],
) -> None:
    """The slots of one tile from a group of channels; the geometry's part adds to the groups' before."""
    _blend_block_adjoint(
        wp.tid() / BLOCK, group, first_channel, columns, tile_offsets, records, slots, splats,
        features, transmittance, grad_features, grad_transmittance, grad_slots, reached,
    )  # fmt: skip


_VECTORS = {size: wp.types.vector(length=size, dtype=wp.float32) for size in GROUPS}
_BLEND = {_VECTORS[size]: wp.overload(_blend, {"group": _VECTORS[size]}) for size in GROUPS}
_BLEND_ADJOINT = {
    _VECTORS[size]: wp.overload(_blend_adjoint, {"group": _VECTORS[size]}) for size in ADJOINT_GROUPS
}
