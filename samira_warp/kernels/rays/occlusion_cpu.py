"""CPU."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch_range

PACKET = 16
AT_ONCE = 32
GRAIN = 32

_BODY = r"""
    #pragma clang fp contract(fast)
    typedef float Row __attribute__((ext_vector_type(16)));
    typedef bool RowMask __attribute__((ext_vector_type(16)));
    typedef float Eight __attribute__((ext_vector_type(8)));
    typedef bool EightMask __attribute__((ext_vector_type(8)));
    auto row = [](const float* values) { return *(const Row*)values; };
    auto eight = [](const float* values) { return *(const Eight*)values; };
    #define ROW_BITS(c) ((unsigned)__builtin_bit_cast(unsigned short, __builtin_convertvector((c), RowMask)))
    #define EIGHT_BITS(c) ((unsigned)__builtin_bit_cast(unsigned char, __builtin_convertvector((c), EightMask)))

    const float px = points.data[3 * index], py = points.data[3 * index + 1], pz = points.data[3 * index + 2];
    const float nx = normals.data[3 * index], ny = normals.data[3 * index + 1], nz = normals.data[3 * index + 2];
    const float ox = offset * nx, oy = offset * ny, oz = offset * nz;
    const int packets = directions.shape[0];
    const int sx = nx > 0.0f ? 24 : 0, sy = ny > 0.0f ? 32 : 8, sz = nz > 0.0f ? 40 : 16;
    const int height = levels.shape[0];

    struct Entry { int node, level; unsigned mask; };
    Entry stack[128];

    for (int begin = 0; begin < packets; begin += 32) {
        const int here = packets - begin < 32 ? packets - begin : 32;
        const float* rays = directions.data + (size_t)begin * 48;
        const float* cone = cones.data + (begin / 32) * 160;
        unsigned live[32], cast[32], open = 0;
        for (int k = 0; k < here; ++k) {
            const float* ray = rays + 48 * k;
            cast[k] = live[k] = ROW_BITS(row(ray) * nx + row(ray + 16) * ny + row(ray + 32) * nz > 0.0f);
            open |= (live[k] ? 1u : 0u) << k;
        }
        int top = 0;
        if (open) stack[top++] = {0, height - 1, open};
        while (top > 0) {
            const Entry entry = stack[--top];
            if (!(entry.mask & open)) continue;
            const float* box = boxes.data + (size_t)(levels.data[entry.level] + entry.node) * 48;
            const Eight above = (eight(box + sx) - px) * nx + (eight(box + sy) - py) * ny + (eight(box + sz) - pz) * nz;
            unsigned left = EIGHT_BITS(above > offset);
            if (!left) continue;
            const Eight lx = eight(box) - px, ux = eight(box + 24) - px;
            const Eight ly = eight(box + 8) - py, uy = eight(box + 32) - py;
            const Eight lz = eight(box + 16) - pz, uz = eight(box + 40) - pz;
            const Eight cx = 0.5f * (lx + ux), cy = 0.5f * (ly + uy), cz = 0.5f * (lz + uz);
            const Eight rx = 0.5f * (ux - lx), ry = 0.5f * (uy - ly), rz = 0.5f * (uz - lz);
            const Eight dd = cx * cx + cy * cy + cz * cz;
            const Eight rr = 1.00002f * (rx * rx + ry * ry + rz * rz) + SLACK;
            const Eight tt = __builtin_elementwise_sqrt(dd - rr);
            const Eight radius = __builtin_elementwise_sqrt(rr);
            alignas(32) float x[8], y[8], z[8], d[8], t[8], r[8];
            *(Eight*)x = cx; *(Eight*)y = cy; *(Eight*)z = cz; *(Eight*)d = dd; *(Eight*)t = tt; *(Eight*)r = radius;
            const unsigned inside = EIGHT_BITS(dd <= rr);

            int child[8], count = 0;
            unsigned seen[8];
            while (left) {
                const int c = __builtin_ctz(left);
                left &= left - 1;
                unsigned mask = entry.mask & open;
                if (!(inside >> c & 1)) {
                    const Row first = x[c] * row(cone) + y[c] * row(cone + 32) + z[c] * row(cone + 64)
                        - t[c] * row(cone + 96) + r[c] * row(cone + 128);
                    const Row second = x[c] * row(cone + 16) + y[c] * row(cone + 48) + z[c] * row(cone + 80)
                        - t[c] * row(cone + 112) + r[c] * row(cone + 144);
                    const float slack = -2e-6f * (t[c] + r[c]);
                    mask &= ROW_BITS(!(first < slack)) | ROW_BITS(!(second < slack)) << 16;
                }
                if (!mask) continue;
                int at = count++;
                while (at > 0 && d[child[at - 1]] > d[c]) { child[at] = child[at - 1]; --at; }
                child[at] = c;
                seen[c] = mask;
            }
            if (entry.level > 0) {
                for (int i = count - 1; i >= 0; --i)
                    stack[top++] = {8 * entry.node + child[i], entry.level - 1, seen[child[i]]};
                continue;
            }
            for (int i = 0; i < count; ++i) {
                const int c = child[i];
                unsigned mask = seen[c] & open;
                if (!mask) continue;
                // rays
                unsigned lanes[32];
                if (inside >> c & 1) {
                    for (unsigned m = mask; m; m &= m - 1) lanes[__builtin_ctz(m)] = live[__builtin_ctz(m)];
                } else {
                    const float tangent = t[c] - 2e-6f * (t[c] + r[c]);
                    for (unsigned m = mask; m; m &= m - 1) {
                        const int k = __builtin_ctz(m);
                        const float* ray = rays + 48 * k;
                        lanes[k] = live[k] & ROW_BITS(
                            !(x[c] * row(ray) + y[c] * row(ray + 16) + z[c] * row(ray + 32) < tangent));
                        if (!lanes[k]) mask &= ~(1u << k);
                    }
                    if (!mask) continue;
                }
                // triangles
                const float* leaf = corners.data + (size_t)(8 * entry.node + c) * 72;
                const Eight ax = (eight(leaf) - px) - ox, ay = (eight(leaf + 8) - py) - oy, az = (eight(leaf + 16) - pz) - oz;
                const Eight bx = (eight(leaf + 24) - px) - ox, by = (eight(leaf + 32) - py) - oy, bz = (eight(leaf + 40) - pz) - oz;
                const Eight gx = (eight(leaf + 48) - px) - ox, gy = (eight(leaf + 56) - py) - oy, gz = (eight(leaf + 64) - pz) - oz;
                const Eight up = __builtin_elementwise_max(__builtin_elementwise_max(
                    ax * nx + ay * ny + az * nz, bx * nx + by * ny + bz * nz), gx * nx + gy * ny + gz * nz);
                if (!EIGHT_BITS(up > 0.0f)) continue;
                const Eight e0x = bx - ax, e0y = by - ay, e0z = bz - az;
                const Eight e1x = gx - bx, e1y = gy - by, e1z = gz - bz;
                const Eight e2x = ax - gx, e2y = ay - gy, e2z = az - gz;
                const Eight det = ax * (e0y * e1z - e0z * e1y) + ay * (e0z * e1x - e0x * e1z) + az * (e0x * e1y - e0y * e1x);
                const Eight one = 1.0f;
                const Eight sign = det < 0.0f ? -one : one;
                auto moment = [&](Eight sx, Eight sy, Eight sz, Eight ex, Eight ey, Eight ez, Eight& mx, Eight& my, Eight& mz) {
                    mx = sign * (sy * ez - sz * ey);
                    my = sign * (sz * ex - sx * ez);
                    mz = sign * (sx * ey - sy * ex);
                };
                Eight m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z;
                moment(ax + bx, ay + by, az + bz, e0x, e0y, e0z, m0x, m0y, m0z);
                moment(bx + gx, by + gy, bz + gz, e1x, e1y, e1z, m1x, m1y, m1z);
                moment(gx + ax, gy + ay, gz + az, e2x, e2y, e2z, m2x, m2y, m2z);
                auto size = [](Eight v) { return __builtin_elementwise_abs(v); };
                const Eight band = -2.4e-7f * (size(m0x) + size(m0y) + size(m0z) + size(m1x) + size(m1y) + size(m1z)
                    + size(m2x) + size(m2y) + size(m2z));
                const Eight never = 3e38f;
                const Eight least = ((up > 0.0f) & (det != 0.0f)) ? band : never;
                for (unsigned m = mask; m; m &= m - 1) {
                    const int k = __builtin_ctz(m);
                    const float* ray = rays + 48 * k;
                    for (unsigned s = lanes[k]; s; s &= s - 1) {
                        const int lane = __builtin_ctz(s);
                        const float dx = ray[lane], dy = ray[lane + 16], dz = ray[lane + 32];
                        const Eight s0 = dx * m0x + dy * m0y + dz * m0z;
                        const Eight s1 = dx * m1x + dy * m1y + dz * m1z;
                        const Eight s2 = dx * m2x + dy * m2y + dz * m2z;
                        if (EIGHT_BITS(__builtin_elementwise_min(__builtin_elementwise_min(s0, s1), s2) >= least))
                            live[k] &= ~(1u << lane);
                    }
                    if (!live[k]) open &= ~(1u << k);
                }
            }
        }
        int* words = result.data + (size_t)index * result.shape[1] + begin / 2;
        for (int k = 0; k < here; k += 2)
            words[k / 2] = (int)~((cast[k] & ~live[k]) | (cast[k + 1] & ~live[k + 1]) << 16);
    }
"""


def occlusion(
    points: Tensor, normals: Tensor, mesh: RayMesh, directions: Tensor, offset: float, result: Tensor
) -> None:
    """Write the bits of `samira_warp.kernels.rays.occlusion.unblocked`."""
    packets = directions.view(-1, PACKET, 3)
    tree = mesh.blocks
    inputs = (
        points,
        normals,
        packets.transpose(1, 2).contiguous(),
        _cones(packets),
        tree.boxes,
        tree.corners,
        tree.levels,
        offset,
    )
    launch_range(_trace_point, len(points), *inputs, result, grain=GRAIN)


def _cones(packets: Tensor) -> Tensor:
    """(B, 5, 32)."""
    axes = torch.nn.functional.normalize(packets.sum(dim=1), dim=1)
    cosines = (packets * axes[:, None]).sum(dim=-1).amin(dim=1)
    wide = cosines < 0.01
    axes = torch.where(wide[:, None], 0.0, axes)
    cosines = torch.where(wide, -1.0, cosines.clamp(max=1.0))
    sines = torch.where(wide, 0.0, (1 - cosines.square()).clamp(min=0).sqrt())
    cones = torch.cat([axes, cosines[:, None], sines[:, None]], dim=1)
    spare = -len(cones) % AT_ONCE
    cones = torch.cat([cones, cones.new_zeros(spare, 5)])
    return cones.view(-1, AT_ONCE, 5).transpose(1, 2).contiguous()


@wp.func_native(_BODY.replace("SLACK", "1e-12f"))
def _trace(
    index: wp.int32,
    points: wp.array2d[wp.float32],
    normals: wp.array2d[wp.float32],
    directions: wp.array3d[wp.float32],
    cones: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    corners: wp.array3d[wp.float32],
    levels: wp.array[wp.int32],
    offset: wp.float32,
    result: wp.array2d[wp.int32],
) -> None: ...


@wp.kernel(enable_backward=False)
def _trace_point(
    first: wp.int32,
    points: wp.array2d[wp.float32],
    normals: wp.array2d[wp.float32],
    directions: wp.array3d[wp.float32],
    cones: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    corners: wp.array3d[wp.float32],
    levels: wp.array[wp.int32],
    offset: wp.float32,
    result: wp.array2d[wp.int32],
) -> None:
    """The words of one point."""
    _trace(first + wp.tid(), points, normals, directions, cones, boxes, corners, levels, offset, result)
