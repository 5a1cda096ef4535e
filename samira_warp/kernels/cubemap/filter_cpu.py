"""The matrix products of a large cubemap filter on the CPU, whose weights never leave a core's cache.

`kernels.cubemap.filter` says what is summed and why eight parities of a map suffice. There are up to a
thousand million weights, and writing them to memory costs as much as making them. So a thread takes 32
results (two vectors of sixteen, in clang's vector types) and goes through all sources in runs of sixteen: it
makes the run's weights in its first-level cache and multiplies them at once with all columns. The weight of a
pair depends on its distance alone, so the same kernel with results and sources exchanged is the adjoint.
"""

from __future__ import annotations

import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime import launch_range

_GROUP = 32
"""Results of one index."""

_SUM_LOBES = r"""
    typedef float Row __attribute__((ext_vector_type(16)));
    const int RUN = 16, STRETCH = 1024;   // sources at a time
    const int COLUMNS = 6;   // columns at a time: with two rows, twelve accumulators
    const int count = results.shape[1], width = sources.shape[1], columns = values.shape[1];
    const float slope = 0.25f * (1.0f - alpha_squared);
    const Row zero = 0.0f;

    // ---- The group's results: directions of two rows of 16, and their sums.
    Row x[2], y[2], z[2], total[2] = {zero, zero};
    for (int k = 0; k < 2; ++k)
        for (int lane = 0; lane < 16; ++lane) {
            const int i = 32 * group + 16 * k + lane, at = i < count ? i : count - 1;
            x[k][lane] = results.data[at];
            y[k][lane] = results.data[count + at];
            z[k][lane] = results.data[2 * count + at];
        }
    // a sum of many thousand terms would lose the last of them to rounding: parts of STRETCH terms come first
    const int cells = 8 * columns * 2;
    Row* sums = (Row*)__builtin_alloca_with_align(2 * cells * sizeof(Row), 512);
    Row* parts = sums + cells;
    Row part[2] = {zero, zero};
    for (int i = 0; i < 2 * cells; ++i) sums[i] = zero;

    // ---- The weights: mass k(c) of the eight flips of source j, and their fast Walsh-Hadamard transform.
    auto lobe_parities = [&](int j, int k, Row (&w)[8]) {
        const float* s = sources.data + j;
        const float sx = s[0], sy = s[width], sz = s[2 * width], mass = s[3 * width];
        const Row dx[2] = {(x[k] - sx) * (x[k] - sx), (x[k] + sx) * (x[k] + sx)};
        const Row dy[2] = {(y[k] - sy) * (y[k] - sy), (y[k] + sy) * (y[k] + sy)};
        const Row dz[2] = {(z[k] - sz) * (z[k] - sz), (z[k] + sz) * (z[k] + sz)};
        #pragma unroll
        for (int f = 0; f < 8; f += 2) {
            const Row near = dx[0] + dy[f >> 1 & 1] + dz[f >> 2];
            const Row far = dx[1] + dy[f >> 1 & 1] + dz[f >> 2];
            const Row one = alpha_squared + slope * near, other = alpha_squared + slope * far;
            // a division costs as much as all the rest: one serves two
            const Row inverse = alpha_squared / (one * other);
            const Row a = inverse * other, b = inverse * one;
            w[f] = mass * __builtin_elementwise_max(1.0f - 0.5f * near, zero) * (a * a);
            w[f + 1] = mass * __builtin_elementwise_max(1.0f - 0.5f * far, zero) * (b * b);
        }
        #pragma unroll
        for (int bit = 1; bit < 8; bit *= 2) {
            #pragma unroll
            for (int f = 0; f < 8; ++f) {
                if (f & bit) continue;
                const Row a = w[f], b = w[f | bit];
                w[f] = a + b;
                w[f | bit] = a - b;
            }
        }
    };

    // ---- The products, a run of sources at a time: weights first ...
    Row weight[8][RUN][2];
    for (int begin = 0; begin < width; begin += RUN) {
        const int run = width - begin < RUN ? width - begin : RUN;
        for (int t = 0; t < run; ++t)
            #pragma unroll
            for (int k = 0; k < 2; ++k) {
                Row w[8];
                lobe_parities(begin + t, k, w);
                part[k] += w[0];
                #pragma unroll
                for (int p = 0; p < 8; ++p) weight[p][t][k] = w[p];
            }
        // ... then all columns while they are in the cache ...
        for (int p = 0; p < 8; ++p)
            for (int c = 0; c < columns; c += COLUMNS) {
                const float* value = values.data + ((size_t)p * columns + c) * width + begin;
                Row a[COLUMNS][2] = {};
                for (int t = 0; t < run; ++t, ++value) {
                    const Row first = weight[p][t][0], second = weight[p][t][1];
                    #pragma unroll
                    for (int i = 0; i < COLUMNS; ++i) {
                        a[i][0] += first * value[(size_t)i * width];
                        a[i][1] += second * value[(size_t)i * width];
                    }
                }
                Row* sum = parts + (p * columns + c) * 2;
                #pragma unroll
                for (int i = 0; i < COLUMNS; ++i) {
                    sum[2 * i] += a[i][0];
                    sum[2 * i + 1] += a[i][1];
                }
            }
        // ... and a stretch's parts to the sums
        if ((begin + RUN) % STRETCH == 0 || begin + RUN >= width) {
            for (int i = 0; i < cells; ++i) { sums[i] += parts[i]; parts[i] = zero; }
            for (int k = 0; k < 2; ++k) { total[k] += part[k]; part[k] = zero; }
        }
    }

    // ---- The results, from rows to their places.
    for (int k = 0; k < 2; ++k)
        for (int lane = 0; lane < 16 && 32 * group + 16 * k + lane < count; ++lane) {
            const int i = 32 * group + 16 * k + lane;
            totals.data[i] = total[k][lane];
            for (int row = 0; row < 8 * columns; ++row)
                products.data[(size_t)row * count + i] = sums[2 * row + k][lane];
        }
"""


def sum_lobes(results: Tensor, sources: Tensor, values: Tensor, alpha: float) -> tuple[Tensor, Tensor]:
    """Sum the parity parts of a map over its octant, weighted by the parities of a lobe.

    The lobe is k of `kernels.cubemap.filter`.

    Args:
        results: (3 or more, I) float32: x, y and z of unit directions in the positive octant.
        sources: (4, J) float32: the same of the sources, and what each weighs besides k.
        values: (8, 6 C, J) float32, contiguous: parity parts of the sources in their six turns.
        alpha: Width of the lobe.

    Returns:
        (8, 6 C, I) sums, and (I,) the sums of the weights alone over all flips.
    """
    count = results.shape[1]
    products, totals = values.new_empty(*values.shape[:2], count), values.new_empty(count)
    launch_range(_sum_lobes, -(-count // _GROUP), results, sources, values, alpha * alpha, products, totals)
    return products, totals


@wp.func_native(_SUM_LOBES)
def _sum_group(
    group: wp.int32,
    results: wp.array2d[wp.float32],
    sources: wp.array2d[wp.float32],
    values: wp.array3d[wp.float32],
    alpha_squared: wp.float32,
    products: wp.array3d[wp.float32],
    totals: wp.array[wp.float32],
) -> None: ...


@wp.kernel(enable_backward=False)
def _sum_lobes(
    first: wp.int32,
    results: wp.array2d[wp.float32],
    sources: wp.array2d[wp.float32],
    values: wp.array3d[wp.float32],
    alpha_squared: wp.float32,
    products: wp.array3d[wp.float32],
    totals: wp.array[wp.float32],
) -> None:
    """Sums of one group of results."""
    _sum_group(first + wp.tid(), results, sources, values, alpha_squared, products, totals)
