"""Blocked directions on the CPU: one walk of a `BlockTree` for a point and up to 512 directions at a time.

Warp compiles a CPU kernel as one scalar loop, so the walk is a native snippet in clang's vector types. All
rays of a point begin at one place, which makes every test short:

- A box, eight of them at a time, is left out where its highest corner is below the point's horizon. Over a
  convex body nothing else is done.
- A ball about what a box holds is a cap of directions, seen from the point. 32 packets of 16 directions, each
  in a cone, are held against the cap at once; a child goes on the stack with the packets that it may block,
  the nearest child on top. Packets without an open direction left fall away.
- Above its leaves the walk goes over to single directions: each is held against the caps of eight leaves at
  once, and every leaf gets a list of what may meet it.
- A ray from the origin meets the triangle (a, b, c) where ``d . (a x b)``, ``d . (b x c)``, ``d . (c x a)``
  all have the sign of ``det(a, b, c)``: one direction against eight triangles, or, where the point lies in
  the leaf's ball, one triangle against packets of sixteen directions.

The moment of an edge is computed as ``(a + b) x (b - a) = 2 a x b``, which has the same bits but for the sign
in both triangles that share the edge (Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, 2013, and
Embree's Pluecker test), relative to the point, so that it does not matter where the mesh stands. Beyond that,
a triangle is larger than it is by the rounding of its moments: `BAND` times the edge and its distance.

What decides is guessed wrongly by the processor more often than it is computed slowly: lists are therefore
written without branches, by a table of the bits of a byte.
"""

from __future__ import annotations

import functools

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.rays.block_tree import WIDTH
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch_range

PACKET = 16
"""Directions of a packet: two vectors of AVX2, or one of AVX-512."""

AT_ONCE = 32
"""Packets of one walk: the bits of a word."""

GRAIN = 32
"""Points that are worth a thread."""

WIDE = 0.01
"""Cosine of the half angle from which on a packet's cone is taken to be the whole sphere: the test of cones
holds for less than a right angle."""

BAND = 2.0**-23
"""What a moment may err by, in units of the edge's length times twice its distance, both as sums over the
axes: four roundings in each of its components and three in its product with a direction, each 2^-24 of
Euclidean lengths, which those sums exceed."""

THIN = 2.0**-18
"""Twice the area over the square of the longest edge, both as sums over the axes, up to which a triangle
counts as one without area: `BAND` then reaches a tenth of its distance beyond its tip."""

_CONSTANTS = f"""
    #pragma clang fp contract(on)
    const int WIDTH = {WIDTH}, PACKET = {PACKET}, AT_ONCE = {AT_ONCE};
    const float BAND = {BAND!r}f, THIN = {THIN!r}f;
    const float SLACK = 2e-6f;   // of a distance: what a product with a direction may err by, and more
    const float ALL = -3e38f;    // a cap that holds all directions
"""

_WORDS = r"""
    typedef float Row __attribute__((ext_vector_type(16)));     // a packet's directions, or half of the cones
    typedef bool RowVotes __attribute__((ext_vector_type(16)));
    typedef float Eight __attribute__((ext_vector_type(8)));    // a node's children, or a leaf's triangles
    typedef bool EightVotes __attribute__((ext_vector_type(8)));
    typedef unsigned short Ids __attribute__((ext_vector_type(8), aligned(2)));
    typedef unsigned short Lanes __attribute__((ext_vector_type(32)));
    typedef bool LanesVotes __attribute__((ext_vector_type(32)));
    auto row = [](const float* values) { return *(const Row*)values; };
    auto eight = [](const float* values) { return *(const Eight*)values; };
    auto row_bits = [](auto votes) -> unsigned {
        return __builtin_bit_cast(unsigned short, __builtin_convertvector(votes, RowVotes));
    };
    auto eight_bits = [](auto votes) -> unsigned {
        return __builtin_bit_cast(unsigned char, __builtin_convertvector(votes, EightVotes));
    };
    auto least = [](auto a, auto b) { return __builtin_elementwise_min(a, b); };
    auto greatest = [](Eight a, Eight b) { return __builtin_elementwise_max(a, b); };
    auto length1 = [](Eight x, Eight y, Eight z) {
        return __builtin_elementwise_abs(x) + __builtin_elementwise_abs(y) + __builtin_elementwise_abs(z);
    };
    auto lowest = [](unsigned bits) { return __builtin_ctz(bits); };
"""

_POINT = r"""
    // ---- The point, and the directions of this walk that it casts.
    const float* point = points.data + 3 * (size_t)index;
    const float* normal = normals.data + 3 * (size_t)index;
    const float px = point[0], py = point[1], pz = point[2], nx = normal[0], ny = normal[1], nz = normal[2];
    const float ox = offset * nx, oy = offset * ny, oz = offset * nz;
    // which of a box's bounds, in its place of `boxes`, are the highest along the normal
    const int top_x = WIDTH * (nx > 0.0f ? 3 : 0), top_y = WIDTH * (ny > 0.0f ? 4 : 1);
    const int top_z = WIDTH * (nz > 0.0f ? 5 : 2);

    const float* rays = packets.data + (size_t)first_packet * 3 * PACKET;
    const float* directions_here = directions.data + (size_t)first_packet * 3 * PACKET;
    const float* cone = cones.data + (size_t)(first_packet / AT_ONCE) * 5 * AT_ONCE;
    const int here = packets.shape[0] - first_packet < AT_ONCE ? packets.shape[0] - first_packet : AT_ONCE;
    alignas(64) unsigned short cast[AT_ONCE] = {}, live[AT_ONCE];   // bits by packet; live: not blocked yet
    for (int k = 0; k < here; ++k) {
        const float* ray = rays + 3 * PACKET * k;
        cast[k] = row_bits(row(ray) * nx + row(ray + 16) * ny + row(ray + 32) * nz > 0.0f);
    }
    __builtin_memcpy(live, cast, sizeof(live));
    auto open_packets = [&]() {
        return __builtin_bit_cast(unsigned, __builtin_convertvector(*(const Lanes*)live != 0, LanesVotes));
    };
"""

_CAPS = r"""
    // ---- Children of the node at hand as caps of directions: a centre, the tangent's length to the ball
    // about it, and the ball's radius. A direction d is in the cap where d . centre >= tangent.
    alignas(32) float x[8], y[8], z[8], squared[8], tangent[8], radius[8];
    auto bound_of = [&](int c) { return tangent[c] - SLACK * (tangent[c] + radius[c]); };
    // packets that have directions in a cap: their axes are within the two half angles of its centre
    auto packets_in = [&](int c) {
        auto half = [&](const float* cone) {
            const Row excess = x[c] * row(cone) + y[c] * row(cone + AT_ONCE) + z[c] * row(cone + 2 * AT_ONCE)
                - tangent[c] * row(cone + 3 * AT_ONCE) + radius[c] * row(cone + 4 * AT_ONCE);
            return row_bits(!(excess < -SLACK * (tangent[c] + radius[c])));
        };
        return half(cone) | half(cone + 16) << 16;
    };
    // a packet's open directions in a cap
    auto lanes_in = [&](int k, float x, float y, float z, float bound) {
        const float* ray = rays + 3 * PACKET * k;
        return live[k] & row_bits(!(x * row(ray) + y * row(ray + 16) + z * row(ray + 32) < bound));
    };
    // the numbers of a packet's directions to the end of a list, which has room for eight more than it needs
    auto append = [&](unsigned short* ids, int count, unsigned lanes, int k) {
        for (int half = 0; half < 2; ++half) {
            const unsigned byte = lanes >> 8 * half & 255;
            const unsigned short first = PACKET * k + 8 * half;
            *(Ids*)(ids + count) = *(const Ids*)(places.data + 8 * byte) + first;
            count += __builtin_popcount(byte);
        }
        return count;
    };
"""

_LEAF = r"""
    // ---- The eight triangles of a leaf: against the listed directions, or, without a list, whole packets.
    auto meet = [&](int leaf, const unsigned short* listed, int count, unsigned whole) {
        const float* corner = corners.data + (size_t)leaf * 9 * WIDTH;
        auto along = [&](int axis, float p, float o) { return (eight(corner + WIDTH * axis) - p) - o; };
        const Eight ax = along(0, px, ox), ay = along(1, py, oy), az = along(2, pz, oz);
        const Eight bx = along(3, px, ox), by = along(4, py, oy), bz = along(5, pz, oz);
        const Eight cx = along(6, px, ox), cy = along(7, py, oy), cz = along(8, pz, oz);
        // those that are nowhere above the horizon are met by no ray, whatever rounding says
        const Eight height = greatest(greatest(
            ax * nx + ay * ny + az * nz, bx * nx + by * ny + bz * nz), cx * nx + cy * ny + cz * nz);
        if (!eight_bits(height > 0.0f)) return;

        const Eight ux = bx - ax, uy = by - ay, uz = bz - az;
        const Eight vx = cx - bx, vy = cy - by, vz = cz - bz;
        const Eight wx = ax - cx, wy = ay - cy, wz = az - cz;
        const Eight gx = uy * vz - uz * vy, gy = uz * vx - ux * vz, gz = ux * vy - uy * vx;
        const Eight volume = ax * gx + ay * gy + az * gz;
        const Eight one = 1.0f, never = -3e38f;
        const Eight side = volume < 0.0f ? -one : one;
        // bands as wide as a triangle would carry it on beyond its tip, and without an area it has no side
        const Eight longest = greatest(
            greatest(length1(ux, uy, uz), length1(vx, vy, vz)), length1(wx, wy, wz));
        const auto has_area = length1(gx, gy, gz) > THIN * longest * longest;
        const auto there = (height > 0.0f) & (volume != 0.0f) & has_area;

        // moments and bands of the three edges; what is not there fails by the first one's band
        Eight moment[3][3], band[3];
        auto take = [&](int edge, Eight sx, Eight sy, Eight sz, Eight ex, Eight ey, Eight ez) {
            moment[edge][0] = side * (sy * ez - sz * ey);
            moment[edge][1] = side * (sz * ex - sx * ez);
            moment[edge][2] = side * (sx * ey - sy * ex);
            band[edge] = BAND * (length1(sx, sy, sz) * length1(ex, ey, ez));
        };
        take(0, ax + bx, ay + by, az + bz, ux, uy, uz);
        take(1, bx + cx, by + cy, bz + cz, vx, vy, vz);
        take(2, cx + ax, cy + ay, cz + az, wx, wy, wz);
        band[0] = there ? band[0] : never;

        // a direction against eight triangles
        for (int i = 0; i < count; ++i) {
            const float* ray = directions_here + 3 * listed[i];
            auto past = [&](int e) {
                return ray[0] * moment[e][0] + (ray[1] * moment[e][1] + (ray[2] * moment[e][2] + band[e]));
            };
            const unsigned hit = eight_bits(least(least(past(0), past(1)), past(2)) >= 0.0f) != 0;
            live[listed[i] / PACKET] &= ~(hit << listed[i] % PACKET);
        }
        if (count) return;

        // a triangle against packets
        for (unsigned left = eight_bits(there); left; left &= left - 1) {
            const int j = lowest(left);
            for (unsigned rest = whole; rest; rest &= rest - 1) {
                const int k = lowest(rest);
                const float* ray = rays + 3 * PACKET * k;
                auto past = [&](int e) {
                    return row(ray) * moment[e][0][j] + (row(ray + 16) * moment[e][1][j]
                        + (row(ray + 32) * moment[e][2][j] + band[e][j]));
                };
                live[k] &= ~row_bits(least(least(past(0), past(1)), past(2)) >= 0.0f);
            }
        }
    };
"""

_WALK = r"""
    // ---- The walk. An entry has a node, the packets that it may block, and the cap it was found by.
    struct Entry { int node, level; unsigned packets; float x, y, z, bound; };
    Entry stack[128];   // seven for each of at most eleven levels, and the last one's eighth
    unsigned short listed[AT_ONCE * PACKET + 8], part[AT_ONCE * PACKET + 8];
    unsigned char meets[AT_ONCE * PACKET];
    int top = 0;
    stack[top++] = {0, (int)levels.shape[0] - 1, ~0u, 0.0f, 0.0f, 0.0f, ALL};
    while (top > 0) {
        const unsigned open = open_packets();
        if (!open) break;
        const Entry entry = stack[--top];
        const unsigned some = entry.packets & open;
        if (!some) continue;

        const float* box = boxes.data + (size_t)(levels.data[entry.level] + entry.node) * 7 * WIDTH;
        const Eight height = (eight(box + top_x) - px) * nx + (eight(box + top_y) - py) * ny
            + (eight(box + top_z) - pz) * nz;
        unsigned left = eight_bits(height > offset);
        if (!left) continue;
        auto centre = [&](int axis, float p) {
            return 0.5f * ((eight(box + WIDTH * axis) - p) + (eight(box + WIDTH * (axis + 3)) - p));
        };
        const Eight cx = centre(0, px), cy = centre(1, py), cz = centre(2, pz);
        const Eight ball = eight(box + 6 * WIDTH), distance2 = cx * cx + cy * cy + cz * cz;
        const Eight reach = __builtin_elementwise_sqrt(distance2 - ball * ball);
        *(Eight*)x = cx; *(Eight*)y = cy; *(Eight*)z = cz;
        *(Eight*)squared = distance2; *(Eight*)tangent = reach; *(Eight*)radius = ball;
        const unsigned within = eight_bits(!(distance2 > ball * ball));   // those whose ball has the point

        // nodes of nodes: on the stack, the nearest on top
        if (entry.level > 0) {
            int child[8], count = 0;
            unsigned seen[8];
            for (; left; left &= left - 1) {
                const int c = lowest(left);
                seen[c] = some & (packets_in(c) | (within >> c & 1 ? ~0u : 0u));
                if (!seen[c]) continue;
                int place = count++;
                for (; place > 0 && squared[child[place - 1]] > squared[c]; --place)
                    child[place] = child[place - 1];
                child[place] = c;
            }
            for (int i = count - 1; i >= 0; --i) {
                const int c = child[i];
                stack[top++] = {WIDTH * entry.node + c, entry.level - 1, seen[c], x[c], y[c], z[c],
                    within >> c & 1 ? ALL : bound_of(c)};
            }
            continue;
        }

        // leaves that the point is in, or all but: most of the packets
        const int first_leaf = WIDTH * entry.node;
        for (unsigned rest = left & within; rest; rest &= rest - 1)
            meet(first_leaf + lowest(rest), part, 0, some);
        left &= ~within;

        // a node that the point is in: packet by packet for each leaf
        if (entry.bound == ALL) {
            for (; left; left &= left - 1) {
                const int c = lowest(left);
                int count = 0;
                for (unsigned rest = some & packets_in(c); rest; rest &= rest - 1) {
                    const int k = lowest(rest);
                    count = append(part, count, lanes_in(k, x[c], y[c], z[c], bound_of(c)), k);
                }
                if (count) meet(first_leaf + c, part, count, 0);
            }
            continue;
        }

        // a node farther away: its cap has a few directions, each of which is held against all leaves
        int count = 0;
        for (unsigned rest = some; rest; rest &= rest - 1) {
            const int k = lowest(rest);
            count = append(listed, count, lanes_in(k, entry.x, entry.y, entry.z, entry.bound), k);
        }
        const Eight bound = reach - SLACK * (reach + ball);
        unsigned met = 0;
        for (int i = 0; i < count; ++i) {
            const float* ray = directions_here + 3 * listed[i];
            meets[i] = eight_bits(!(ray[0] * cx + ray[1] * cy + ray[2] * cz < bound));
            met |= meets[i];
        }
        for (left &= met; left; left &= left - 1) {
            const int c = lowest(left);
            int size = 0;
            for (int i = 0; i < count; ++i) {
                part[size] = listed[i];
                size += meets[i] >> c & 1;
            }
            meet(first_leaf + c, part, size, 0);
        }
    }

    // ---- A word has two packets.
    int* words = result.data + (size_t)index * result.shape[1] + first_packet / 2;
    for (int k = 0; k < here; k += 2) {
        const unsigned low = cast[k] & ~live[k], high = cast[k + 1] & ~live[k + 1];
        words[k / 2] = (int)~(low | high << 16);
    }
"""


def occlusion(
    points: Tensor, normals: Tensor, mesh: RayMesh, directions: Tensor, offset: float, result: Tensor
) -> None:
    """Write the bits of `samira_warp.kernels.rays.occlusion.unblocked`."""
    packets = directions.view(-1, PACKET, 3)
    rays = (directions, packets.transpose(1, 2).contiguous(), _cones(packets), _places())
    tree = mesh.blocks
    inputs = (points, normals, *rays, tree.boxes, tree.corners, tree.levels, offset)
    launch_range(_walk_point, len(points), *inputs, result, grain=GRAIN)


def _cones(packets: Tensor) -> Tensor:
    """(P / 32, 5, 32) cones that hold the (P, 16, 3) directions of each packet: axis, cosine and sine.

    In float64: the cosine of a narrow cone tells little of its angle.
    """
    axes = torch.nn.functional.normalize(packets.sum(dim=1), dim=1)
    cosines = torch.cosine_similarity(packets.double(), axes[:, None].double(), dim=-1, eps=1e-30).amin(dim=1)
    cosines = cosines.clamp(max=1.0)
    wide = cosines < WIDE
    # an axis of nothing, which passes every cap
    axes = axes.masked_fill(wide[:, None], 0.0)
    sines = (1.0 - cosines.square()).sqrt().masked_fill(wide, 0.0)
    cosines = cosines.masked_fill(wide, -1.0)
    cones = torch.cat([axes, cosines[:, None], sines[:, None]], dim=1).float()
    spare = -len(cones) % AT_ONCE
    return torch.nn.functional.pad(cones, (0, 0, 0, spare)).view(-1, AT_ONCE, 5).transpose(1, 2).contiguous()


@functools.cache
def _places() -> Tensor:
    """(256, 8) int16: the places of the bits of each byte, then zeros."""
    rows = [[place for place in range(8) if byte >> place & 1] for byte in range(256)]
    return torch.tensor([row + [0] * (8 - len(row)) for row in rows], dtype=torch.int16)


@wp.func_native(_CONSTANTS + _WORDS + _POINT + _CAPS + _LEAF + _WALK)
def _walk(
    index: wp.int32,
    first_packet: wp.int32,
    points: wp.array2d[wp.float32],
    normals: wp.array2d[wp.float32],
    directions: wp.array2d[wp.float32],
    packets: wp.array3d[wp.float32],
    cones: wp.array3d[wp.float32],
    places: wp.array2d[wp.int16],
    boxes: wp.array3d[wp.float32],
    corners: wp.array3d[wp.float32],
    levels: wp.array[wp.int32],
    offset: wp.float32,
    result: wp.array2d[wp.int32],
) -> None: ...


@wp.kernel(enable_backward=False)
def _walk_point(
    first: wp.int32,
    points: wp.array2d[wp.float32],
    normals: wp.array2d[wp.float32],
    directions: wp.array2d[wp.float32],
    packets: wp.array3d[wp.float32],
    cones: wp.array3d[wp.float32],
    places: wp.array2d[wp.int16],
    boxes: wp.array3d[wp.float32],
    corners: wp.array3d[wp.float32],
    levels: wp.array[wp.int32],
    offset: wp.float32,
    result: wp.array2d[wp.int32],
) -> None:
    """The words of one point."""
    for walk in range(cones.shape[0]):
        _walk(
            first + wp.tid(), AT_ONCE * walk, points, normals, directions, packets, cones, places,
            boxes, corners, levels, offset, result,
        )  # fmt: skip
