"""The gather on a CPU: one index makes a whole row, whose entries are read once for all its channels.

A GPU has a thread a number instead (`kernels.gathering.gather`). Channels are summed eight at a time, in
registers, what is left four, two and one at a time, and each in the order of the entries, so both make the
same sums.
"""

from __future__ import annotations

import warp as wp

GRAIN = 2048
"""Rows that are worth a thread."""

_SUM_ROW = """
    const int channels = result.shape[1];
    // as many channels from this one on as the block holds
    auto sum = [&](auto& total, int channel) {
        constexpr int COUNT = sizeof(total) / sizeof(float);
        for (int entry = begin; entry < end; ++entry) {
            const float weight = weights.data[entry];
            if (weight == 0.0f) continue;   // what it points at may be anything
            const float* source = values.data + (size_t)sources.data[entry] * channels + channel;
            #pragma unroll
            for (int i = 0; i < COUNT; ++i) total[i] += weight * source[i];
        }
        float* out = result.data + (size_t)row * channels + channel;
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) out[i] = total[i];
        return channel + COUNT;
    };
    int channel = 0;
    while (channel + 8 <= channels) { float total[8] = {}; channel = sum(total, channel); }
    if (channel + 4 <= channels) { float total[4] = {}; channel = sum(total, channel); }
    if (channel + 2 <= channels) { float total[2] = {}; channel = sum(total, channel); }
    if (channel < channels) { float total[1] = {}; channel = sum(total, channel); }
"""


@wp.func_native(_SUM_ROW)
def _sum_row(
    row: wp.int32,
    begin: wp.int32,
    end: wp.int32,
    sources: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    values: wp.array2d[wp.float32],
    result: wp.array2d[wp.float32],
) -> None: ...


@wp.kernel(enable_backward=False)
def gather_row(
    first: wp.int32,
    entries: wp.int32,
    sources: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    values: wp.array2d[wp.float32],
    result: wp.array2d[wp.float32],
) -> None:
    """A row that has ``entries`` of its own."""
    row = first + wp.tid()
    _sum_row(row, row * entries, (row + 1) * entries, sources, weights, values, result)


@wp.kernel(enable_backward=False)
def gather_group(
    first: wp.int32,
    offsets: wp.array[wp.int32],
    sources: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    values: wp.array2d[wp.float32],
    result: wp.array2d[wp.float32],
) -> None:
    """A row whose entries lie from its offset to the next."""
    row = first + wp.tid()
    _sum_row(row, offsets[row], offsets[row + 1], sources, weights, values, result)
