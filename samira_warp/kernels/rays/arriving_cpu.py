"""Sums over the directions above points on the CPU, sixteen directions at a time in clang's vector types.

Warp compiles a CPU kernel as one scalar loop, so the loops over directions are native snippets; `arriving`
says the same one direction at a time in Warp. Directions and powers come in packets: (D / 16, 3, 16), so that
a coordinate of sixteen of them is one vector.
"""

from __future__ import annotations

import warp as wp
from torch import Tensor

from samira_warp.kernels.runtime import launch_range

PACKET = 16
"""Directions in a vector."""

GRAIN = 256
"""Points that are worth a thread, with some four hundred directions each."""

_VECTORS = """
    #pragma clang fp contract(on)
    typedef float Row __attribute__((ext_vector_type(16)));   // one number of 16 directions
    typedef int Mask __attribute__((ext_vector_type(16)));
    const Row zero = 0.0f;
    auto row = [](const float* values) { return *(const Row*)values; };
    auto total = [](Row v) {
        const auto h = v.lo + v.hi;
        const auto q = h.lo + h.hi;
        return (q[0] + q[2]) + (q[1] + q[3]);
    };
    // which of packet p's directions are open at a point: sixteen bits of its row of words
    const Mask lane = {1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    auto open_at = [&](int point, int p) -> Mask {
        const int flags = bits.data[point * bits.shape[1] + p / 2] >> (16 * (p & 1));
        return (lane & flags) != 0;
    };
    // cosines between an axis and packet p
    auto cosines = [&](const float* axis, int p) -> Row {
        const float* d = directions.data + 48 * p;
        return axis[0] * row(d) + axis[1] * row(d + 16) + axis[2] * row(d + 32);
    };
"""

_ARRIVING = """
    const float* normal = (const float*)(normals.data + m);
    Row all[3] = {}, open[3] = {};
    for (int p = 0; p < directions.shape[0]; ++p) {
        const Row cosine = __builtin_elementwise_max(cosines(normal, p), zero);
        const Mask is_open = open_at(m, p);
        for (int c = 0; c < 3; ++c) {
            const Row light = cosine * row(powers.data + 48 * p + 16 * c);
            all[c] += light;
            open[c] += is_open ? light : zero;
        }
    }
    for (int c = 0; c < 3; ++c) {
        ((float*)(arriving.data + m))[c] = total(open[c]);
        ((float*)(unblocked.data + m))[c] = total(all[c]);
    }
"""

_ADJOINT = """
    Row sums[3] = {};
    for (int m = 0; m < normals.shape[0]; ++m) {
        const float* to_open = (const float*)(grad_arriving.data + m);
        const float* to_all = (const float*)(grad_unblocked.data + m);
        const Row cosine = __builtin_elementwise_max(cosines((const float*)(normals.data + m), p), zero);
        const Mask is_open = open_at(m, p);
        for (int c = 0; c < 3; ++c) sums[c] += cosine * ((is_open ? zero + to_open[c] : zero) + to_all[c]);
    }
    for (int c = 0; c < 3; ++c) *(Row*)(grad_powers.data + 48 * p + 16 * c) = sums[c];
"""

_LOBES = """
    const float* axis = (const float*)(axes.data + m);
    const int lobes = edges.shape[0];
    for (int k = 0; k < lobes; ++k) {
        Row all = 0.0f, open = 0.0f;
        for (int p = 0; p < directions.shape[0]; ++p) {
            const Row above = __builtin_elementwise_max(cosines(axis, p) - edges.data[k], zero);
            const Row weight = above * above * row(areas.data + 16 * p);
            all += weight;
            open += open_at(m, p) ? weight : zero;
        }
        const float whole = total(all);
        result.data[m * lobes + k] = whole > 0.0f ? total(open) / whole : 1.0f;
    }
"""


def in_packets(values: Tensor) -> Tensor:
    """(D / 16, C, 16) of (D, C)."""
    return values.unflatten(0, (-1, PACKET)).mT.contiguous()


def out_of_packets(values: Tensor) -> Tensor:
    """(D, C) of (D / 16, C, 16)."""
    return values.mT.flatten(0, 1)


def sum_arriving(
    bits: Tensor, normals: Tensor, directions: Tensor, powers: Tensor, arriving: Tensor, unblocked: Tensor
) -> None:
    """The sums of `arriving.arriving_irradiance`, into (M, 3) each."""
    packets = (in_packets(directions), in_packets(powers))
    launch_range(_arriving, len(bits), bits, normals, *packets, arriving, unblocked, grain=GRAIN)


def sum_adjoint(
    bits: Tensor, normals: Tensor, directions: Tensor, grad_arriving: Tensor, grad_unblocked: Tensor
) -> Tensor:
    """(D, 3) gradient of the powers."""
    packets = in_packets(directions)
    result = packets.new_empty(packets.shape)
    inputs = (bits, normals, packets, grad_arriving, grad_unblocked)
    launch_range(_arriving_adjoint, len(packets), *inputs, result, grain=1)
    return out_of_packets(result)


def sum_lobes(
    bits: Tensor, axes: Tensor, edges: Tensor, directions: Tensor, areas: Tensor, result: Tensor
) -> None:
    """The shares of `arriving.open_shares`, into (M, K)."""
    launch_range(_lobes, len(bits), bits, axes, edges, in_packets(directions), areas, result, grain=GRAIN)


@wp.func_native(_VECTORS + _ARRIVING)
def _sum_point(
    m: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array3d[wp.float32],
    powers: wp.array3d[wp.float32],
    arriving: wp.array[wp.vec3],
    unblocked: wp.array[wp.vec3],
) -> None: ...


@wp.func_native(_VECTORS + _ADJOINT)
def _sum_packet(
    p: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array3d[wp.float32],
    grad_arriving: wp.array[wp.vec3],
    grad_unblocked: wp.array[wp.vec3],
    grad_powers: wp.array3d[wp.float32],
) -> None: ...


@wp.func_native(_VECTORS + _LOBES)
def _share_lobes(
    m: wp.int32,
    bits: wp.array2d[wp.int32],
    axes: wp.array[wp.vec3],
    edges: wp.array[wp.float32],
    directions: wp.array3d[wp.float32],
    areas: wp.array[wp.float32],
    result: wp.array2d[wp.float32],
) -> None: ...


@wp.kernel(enable_backward=False)
def _arriving(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array3d[wp.float32],
    powers: wp.array3d[wp.float32],
    arriving: wp.array[wp.vec3],
    unblocked: wp.array[wp.vec3],
) -> None:
    """One point. Both sums take the same steps, so that they end in the same bits where all is open."""
    _sum_point(first + wp.tid(), bits, normals, directions, powers, arriving, unblocked)


@wp.kernel(enable_backward=False)
def _arriving_adjoint(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    normals: wp.array[wp.vec3],
    directions: wp.array3d[wp.float32],
    grad_arriving: wp.array[wp.vec3],
    grad_unblocked: wp.array[wp.vec3],
    grad_powers: wp.array3d[wp.float32],
) -> None:
    """One packet of directions: the points that they light, in their order."""
    _sum_packet(first + wp.tid(), bits, normals, directions, grad_arriving, grad_unblocked, grad_powers)


@wp.kernel(enable_backward=False)
def _lobes(
    first: wp.int32,
    bits: wp.array2d[wp.int32],
    axes: wp.array[wp.vec3],
    edges: wp.array[wp.float32],
    directions: wp.array3d[wp.float32],
    areas: wp.array[wp.float32],
    result: wp.array2d[wp.float32],
) -> None:
    """The lobes of one point."""
    _share_lobes(first + wp.tid(), bits, axes, edges, directions, areas, result)
