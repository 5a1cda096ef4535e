"""Blending on the CPU: one Warp thread per tile, sixteen pixels of a row at a time in clang's vector types.

Warp compiles a CPU kernel as one scalar loop, so the tile bodies are native snippets.
`samira_warp/kernels/plain/blending.py` says the same one pixel at a time in Warp. The mathematics is that of
`samira_warp.kernels.raster.blending`; the arrangement is:

- A tile takes its Gaussians in batches. For a batch it finds which rows each ellipse crosses inside the tile
  (16 Gaussians at a time) and lists the Gaussians of each row. A row then goes through its list with its
  transmittance in a register, and leaves its weights behind.
- Channels follow as products of those weights and the features (or the gradient), so an accumulator stays in
  a register over the list.
- A lane whose transmittance would fall below TRANSMITTANCE_MIN stops: the transmittance moves from ``live``
  to ``final``, and ``live`` is 0 from then on. A row whose lanes have all stopped is skipped, a tile whose
  rows have all stopped is done.
"""

from __future__ import annotations

import math

import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.slots import GEOMETRY, SlotGradients
from samira_warp.kernels.raster.splats import RECORD
from samira_warp.kernels.raster.tiles import TileBins
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

LANES = 4
"""Channels are padded with zeros to a multiple of this: the forward product runs over four accumulators."""

GRAIN = 4
"""Tiles that are worth a thread."""

_CONSTANTS = f"""
    #pragma clang fp contract(on)   // within an expression, so that forward and backward round alike
    const float ALPHA_MAX = {ALPHA_MAX!r}f, ALPHA_MIN = {ALPHA_MIN!r}f;
    const float TRANSMITTANCE_MIN = {TRANSMITTANCE_MIN!r}f;
    const float LN2 = {math.log(2.0)!r}f;
    const int RECORD = {RECORD}, GEOMETRY = {GEOMETRY}, LANES = {LANES};
"""

_TILE = r"""
    typedef float Row __attribute__((ext_vector_type(16)));   // 16 neighbouring pixels, or 16 Gaussians
    typedef int Bits __attribute__((ext_vector_type(16)));
    const int BATCH = 32;
    const Row ramp = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    const Row zero = 0.0f;

    const int tile_left = 16 * (tile % columns), tile_top = 16 * (tile / columns);
    const int start = tile_offsets.data[tile], end = tile_offsets.data[tile + 1];
    const int stride = splats.shape[1], padded = stride - RECORD;

    // ---- The batch: geometry relative to the tile's first pixel centre, features, and each row's Gaussians.
    alignas(64) float mean_x[BATCH] = {}, mean_y[BATCH] = {};
    alignas(64) float root[BATCH] = {}, shear[BATCH] = {}, rest[BATCH] = {};
    alignas(64) float level[BATCH] = {}, cut[BATCH] = {};
    const float* feature[BATCH];
    int listed[16][BATCH], count[16];

    auto least = [](Row a, Row b) { return __builtin_elementwise_min(a, b); };
    auto greatest = [](Row a, Row b) { return __builtin_elementwise_max(a, b); };
    auto square_root = [](Row v) { return __builtin_elementwise_sqrt(v); };
    auto whole_number = [](Row v) { return __builtin_convertvector(v, Bits); };
    auto load = [](const float* values) { return *(const Row*)values; };
    auto any = [](Row v) { return __builtin_reduce_or(__builtin_bit_cast(Bits, v)) != 0; };

    auto take_batch = [&](int begin, int size) {
        // the next batch's records lie anywhere: ask for them now
        for (int next = begin + size; next < end && next < begin + size + BATCH; ++next)
            for (int line = 0; line < stride; line += 16)
                __builtin_prefetch(splats.data + (size_t)records.data[next] * stride + line);
        for (int j = 0; j < size; ++j) {
            const float* splat = splats.data + (size_t)records.data[begin + j] * stride;
            mean_x[j] = splat[0] - (tile_left + 0.5f);
            mean_y[j] = splat[1] - (tile_top + 0.5f);
            root[j] = splat[2]; shear[j] = splat[3]; rest[j] = splat[4];
            level[j] = splat[5]; cut[j] = splat[6];
            feature[j] = splat + RECORD;
        }
        // Rows where the ellipse (p dx + s dy)^2 + v dy^2 <= q lies between the tile's outer columns. Its
        // upper edge over dx, dy = (-p s dx + sqrt(q c - p^2 v dx^2)) / c with c = s^2 + v, is concave:
        // highest at its top, or at the column nearest to that.
        alignas(64) int first[BATCH], last[BATCH];
        for (int j = 0; j < size; j += 16) {
            const Row x = load(mean_x + j), y = load(mean_y + j), q = load(cut + j);
            const Row p = load(root + j), s = load(shear + j), v = load(rest + j);
            const Row c = s * s + v, D = p * p * v;
            const Row top = s * square_root(q / v) / p;   // dx at the lowest point, minus dx at the topmost
            const Row low = -x, high = 15.0f - x;
            const Row up = least(greatest(-top, low), high);
            const Row down = least(greatest(top, low), high);
            const Row up_root = square_root(greatest(q * c - D * up * up, zero));
            const Row down_root = square_root(greatest(q * c - D * down * down, zero));
            const Row lower = __builtin_elementwise_ceil(y - (p * s * down + down_root) / c);
            const Row upper = __builtin_elementwise_floor(y + (up_root - p * s * up) / c);
            // a NaN loses to the bound: then every row is taken
            *(Bits*)(first + j) = whole_number(least(greatest(lower, zero), 16.0f));
            *(Bits*)(last + j) = whole_number(greatest(least(upper, 15.0f), -1.0f));
        }
        for (int r = 0; r < 16; ++r) count[r] = 0;
        for (int j = 0; j < size; ++j)
            for (int r = first[j]; r <= last[j]; ++r) listed[r][count[r]++] = j;
    };

    // ---- One Gaussian along one row.
    // opacity * exp(-sigma) of Gaussian j in row r: 2^t by rounding t and a polynomial, relative error 2e-7
    auto density = [&](int j, int r) {
        const float dy = r - mean_y[j];
        const Row dx = ramp - mean_x[j];
        const Row along = root[j] * dx + shear[j] * dy;
        const Row t = greatest((level[j] - rest[j] * dy * dy) - along * along, -126.0f);
        const Row whole = __builtin_elementwise_roundeven(t);
        const Row u = t - whole;
        const Row power = 1.0f + u * (0.693147f + u * (0.24022242f + u * (0.055507336f
            + u * (0.009671513f + u * 0.0013264727f))));
        return __builtin_bit_cast(Row, __builtin_bit_cast(Bits, power) + (whole_number(whole) << 23));
    };
    auto alpha_of = [&](Row density) {
        const Row alpha = least(density, ALPHA_MAX);
        return alpha < ALPHA_MIN ? zero : alpha;
    };

    // ---- Front-to-back state of the tile's pixels; those outside the image have stopped from the start.
    Row live[16], final[16];
    for (int r = 0; r < 16; ++r) {
        const float visible = tile_top + r < height ? (float)(width - tile_left) : 0.0f;
        live[r] = ramp < visible ? zero + 1.0f : zero;
        final[r] = 0.0f;
    }
    auto absorb = [&](Row alpha, Row& live, Row& final) {
        const Row weight = alpha * live, next = live - weight;
        const Bits stop = next < TRANSMITTANCE_MIN;
        final += stop ? live : zero;
        live = stop ? zero : next;
        return stop ? zero : weight;
    };
"""

_FORWARD = r"""
    // ---- The forward pass, batch by batch and row by row, until every pixel has stopped.
    // sums[r][c]: one row of one channel
    Row* sums = (Row*)__builtin_alloca_with_align(16 * padded * sizeof(Row), 512);
    for (int i = 0; i < 16 * padded; ++i) sums[i] = 0.0f;

    bool unfinished = true;
    for (int begin = start; begin < end && unfinished; begin += BATCH) {
        take_batch(begin, end - begin < BATCH ? end - begin : BATCH);
        unfinished = false;
        for (int r = 0; r < 16; ++r) {
            if (!any(live[r])) continue;
            unfinished = true;
            const int n = count[r];
            const int* list = listed[r];
            // weights first, front to back ...
            Row weight[BATCH];
            Row row_live = live[r], row_final = final[r];
            for (int i = 0; i < n; ++i)
                weight[i] = absorb(alpha_of(density(list[i], r)), row_live, row_final);
            live[r] = row_live;
            final[r] = row_final;
            // ... then their products with the features, whose sums stay in registers over the list
            for (int c = 0; c < padded; c += LANES) {
                Row* sum = sums + r * padded + c;
                Row s0 = sum[0], s1 = sum[1], s2 = sum[2], s3 = sum[3];
                for (int i = 0; i < n; ++i) {
                    const float* f = feature[list[i]] + c;
                    s0 += weight[i] * f[0]; s1 += weight[i] * f[1];
                    s2 += weight[i] * f[2]; s3 += weight[i] * f[3];
                }
                sum[0] = s0; sum[1] = s1; sum[2] = s2; sum[3] = s3;
            }
        }
    }

    // ---- The pixels, from rows to image order.
    const int channels = features.shape[2];
    for (int r = 0; r < 16 && tile_top + r < height; ++r)
        for (int x = 0; x < 16 && tile_left + x < width; ++x) {
            const size_t pixel = (size_t)(tile_top + r) * width + tile_left + x;
            for (int c = 0; c < channels; ++c) features.data[pixel * channels + c] = sums[r * padded + c][x];
            transmittance.data[pixel] = live[r][x] + final[r][x];
        }
"""

_BACKWARD = r"""
    typedef float Octet __attribute__((ext_vector_type(8)));   // eight channels of one pixel
    // a gradient's channels go by eights; up to four that are left go one by one
    const int channels = features.shape[2], left = channels % 8 <= 4 ? channels % 8 : 0;
    const int octets = (channels - left + 7) / 8;

    // ---- The output's gradient, and what of it lies behind.
    // The gradient twice: per channel as rows of pixels, and per pixel as octets of channels.
    Row* grad_by_channel = (Row*)__builtin_alloca_with_align(16 * padded * sizeof(Row), 512);
    Octet* grad_by_pixel = (Octet*)__builtin_alloca_with_align(256 * octets * sizeof(Octet), 512);
    Octet* grad_feature = (Octet*)__builtin_alloca_with_align(BATCH * octets * sizeof(Octet), 512);
    Row grad_left[BATCH][4];   // of channel 8 * octets and the next, not yet summed over the row
    for (int i = 0; i < 16 * padded; ++i) grad_by_channel[i] = 0.0f;
    for (int i = 0; i < 256 * octets; ++i) grad_by_pixel[i] = 0.0f;
    // What the pixel's gradient still has to meet behind the Gaussian at hand: the sum of weight * dot, and
    // the background's share. Before the first Gaussian that is the image itself times its gradient.
    Row behind[16];
    for (int r = 0; r < 16; ++r) {
        behind[r] = 0.0f;
        for (int x = 0; x < 16 && tile_left + x < width && tile_top + r < height; ++x) {
            const size_t pixel = (size_t)(tile_top + r) * width + tile_left + x;
            float sum = transmittance.data[pixel] * grad_transmittance.data[pixel];
            for (int c = 0; c < channels; ++c) {
                const float grad = grad_features.data[pixel * channels + c];
                grad_by_channel[r * padded + c][x] = grad;
                if (c < 8 * octets) ((float*)(grad_by_pixel + (r * 16 + x) * octets))[c] = grad;
                sum += features.data[pixel * channels + c] * grad;
            }
            behind[r][x] = sum;
        }
    }

    // ---- What a batch accumulates, and the slots in which it ends.
    auto total = [](Row v) {
        const Octet h = v.lo + v.hi;
        const auto q = h.lo + h.hi;
        return (q[0] + q[2]) + (q[1] + q[3]);
    };
    // gradient of sigma, times 1, dy and dy^2, summed over the rows of each Gaussian of the batch
    Row moment0[BATCH], moment1[BATCH], moment2[BATCH];

    // the reduction over the tile: one sum of 16 lanes per value, once a Gaussian has met all rows
    auto write_slot = [&](int j, int entry) {
        float* slot = grad_slots.data + (size_t)slots.data[entry] * grad_slots.shape[1];
        const float p = root[j], s = shear[j];
        const float A = 2.0f * LN2 * p * p, B = 2.0f * LN2 * p * s, C = 2.0f * LN2 * (s * s + rest[j]);
        const Row dx = ramp - mean_x[j], first = moment0[j] * dx;
        const float sum_x = total(first), sum_y = total(moment1[j]);
        const float inverse_opacity = feature[j][7 - RECORD];
        slot[0] = -(A * sum_x + B * sum_y);
        slot[1] = -(B * sum_x + C * sum_y);
        slot[2] = 0.5f * total(first * dx);
        slot[3] = total(moment1[j] * dx);
        slot[4] = 0.5f * total(moment2[j]);
        slot[5] = -total(moment0[j]) * inverse_opacity;
        __builtin_memcpy(slot + GEOMETRY, grad_feature + j * octets, (channels - left) * sizeof(float));
        for (int c = 0; c < left; ++c) slot[GEOMETRY + 8 * octets + c] = total(grad_left[j][c]);
        reached.data[slots.data[entry]] = true;
    };

    // ---- The adjoint, front to back.
    bool unfinished = true;
    for (int begin = start; begin < end && unfinished; begin += BATCH) {
        const int size = end - begin < BATCH ? end - begin : BATCH;
        take_batch(begin, size);
        for (int j = 0; j < size; ++j) {
            moment0[j] = moment1[j] = moment2[j] = 0.0f;
            for (int o = 0; o < octets; ++o) grad_feature[j * octets + o] = 0.0f;
            for (int c = 0; c < left; ++c) grad_left[j][c] = 0.0f;
        }
        unfinished = false;
        for (int r = 0; r < 16; ++r) {
            if (!any(live[r])) continue;
            unfinished = true;
            const int n = count[r];
            const int* list = listed[r];
            Row weight[BATCH];
            Row row_live = live[r], row_final = final[r], row_behind = behind[r];
            for (int i = 0; i < n; ++i) {
                // the forward pass again, which stops at the same places, and the gradient of the density
                const int j = list[i];
                Row dot = 0.0f;
                for (int c = 0; c < padded; c += LANES) {
                    const Row* grad = grad_by_channel + r * padded + c;
                    const float* f = feature[j] + c;
                    dot += (f[0] * grad[0] + f[1] * grad[1]) + (f[2] * grad[2] + f[3] * grad[3]);
                }
                const Row value = density(j, r), alpha = alpha_of(value);
                weight[i] = absorb(alpha, row_live, row_final);
                row_behind -= weight[i] * dot;
                // dL/dsigma = -alpha dL/dalpha, dL/dalpha = T dot - behind / (1 - alpha);
                // none through the cap, the cut or the stop
                const Row through = row_behind * (alpha / (1.0f - alpha)) - weight[i] * dot;
                const Row grad_sigma = ((weight[i] > 0.0f) & (value <= ALPHA_MAX)) ? through : zero;
                const float dy = r - mean_y[j];
                moment0[j] += grad_sigma;
                moment1[j] += grad_sigma * dy;
                moment2[j] += grad_sigma * (dy * dy);
                for (int c = 0; c < left; ++c)
                    grad_left[j][c] += weight[i] * grad_by_channel[r * padded + 8 * octets + c];
            }
            live[r] = row_live;
            final[r] = row_final;
            behind[r] = row_behind;
            // the features' gradients: weights times the output's, summed over the row's pixels
            for (int i = 0; i < n; ++i) {
                const float* w = (const float*)(weight + i);
                for (int o = 0; o < octets; ++o) {
                    const Octet* grad = grad_by_pixel + r * 16 * octets + o;
                    Octet s0 = 0.0f, s1 = 0.0f, s2 = 0.0f, s3 = 0.0f;
                    for (int x = 0; x < 16; x += 4) {
                        s0 += w[x] * grad[x * octets];
                        s1 += w[x + 1] * grad[(x + 1) * octets];
                        s2 += w[x + 2] * grad[(x + 2) * octets];
                        s3 += w[x + 3] * grad[(x + 3) * octets];
                    }
                    grad_feature[list[i] * octets + o] += (s0 + s1) + (s2 + s3);
                }
            }
        }
        for (int j = 0; j < size; ++j) write_slot(j, begin + j);
    }
"""


def forward(splats: Tensor, bins: TileBins, channels: int, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Features (H, W, C) and transmittance (H, W) from splat records padded to LANES."""
    features, transmittance = splats.new_empty(height, width, channels), splats.new_empty(height, width)
    grid, lists = (bins.columns, width, height), (bins.tile_offsets, bins.records)
    tiles = bins.columns * bins.rows
    launch_range(_blend_tile, tiles, *grid, *lists, splats, features, transmittance, grain=GRAIN)
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
    height, width, channels = features.shape
    grad_slots = SlotGradients.allocate(bins, channels)
    grid, lists = (bins.columns, width, height), (bins.tile_offsets, bins.records, bins.slots)
    images = (features, transmittance, grad_features, grad_transmittance)
    tiles = bins.columns * bins.rows
    launch_range(_blend_tile_adjoint, tiles, *grid, *lists, splats, *images, *grad_slots, grain=GRAIN)
    return grad_slots


@wp.func_native(_CONSTANTS + _TILE + _FORWARD)
def _blend_rows(
    tile: wp.int32,
    columns: wp.int32,
    width: wp.int32,
    height: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None: ...


@wp.func_native(_CONSTANTS + _TILE + _BACKWARD)
def _blend_rows_adjoint(
    tile: wp.int32,
    columns: wp.int32,
    width: wp.int32,
    height: wp.int32,
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


@wp.kernel(enable_backward=False)
def _blend_tile(
    first: wp.int32,
    columns: wp.int32,
    width: wp.int32,
    height: wp.int32,
    tile_offsets: wp.array[wp.int32],
    records: wp.array[wp.int32],
    splats: wp.array2d[wp.float32],
    features: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None:
    """Blend the pixels of one tile: features (H, W, C) and transmittance (H, W)."""
    _blend_rows(
        first + wp.tid(), columns, width, height, tile_offsets, records, splats, features, transmittance
    )


@wp.kernel(enable_backward=False)
def _blend_tile_adjoint(
    first: wp.int32,
    columns: wp.int32,
    width: wp.int32,
    height: wp.int32,
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
    """Write the gradients of one tile's intersections, each to its slot."""
    _blend_rows_adjoint(
        first + wp.tid(), columns, width, height, tile_offsets, records, slots, splats,
        features, transmittance, grad_features, grad_transmittance, grad_slots, reached,
    )  # fmt: skip
