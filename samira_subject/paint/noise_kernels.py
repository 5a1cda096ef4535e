"""Value noise and spots, one Warp thread per place."""

from __future__ import annotations

import warp as wp

UNIT = wp.constant(1.0 / 16777216.0)
"""2^-24: as many bits as a float32 holds exactly."""

_ACROSS = wp.constant(wp.uint32(0x8DA6B343))
_UP = wp.constant(wp.uint32(0xD8163841))
_AHEAD = wp.constant(wp.uint32(0xCB1AB31F))
_SEED = wp.constant(wp.uint32(0x9E3779B9))
_FIRST = wp.constant(wp.uint32(0x85EBCA6B))
_SECOND = wp.constant(wp.uint32(0xC2B2AE35))
"""Odd multipliers: three for the axes (Teschner et al., 2003), one for the seed, two that finish."""


@wp.func
def _number(x: wp.int32, y: wp.int32, z: wp.int32, seed: wp.uint32) -> wp.float32:
    """A number in -1..1 that belongs to a cell.

    A hash by multiplication, finished as MurmurHash3 does (Appleby, 2008).
    """
    value = (wp.uint32(x) * _ACROSS) ^ (wp.uint32(y) * _UP) ^ (wp.uint32(z) * _AHEAD)
    value = value ^ (seed * _SEED)
    value = (value ^ (value >> wp.uint32(16))) * _FIRST
    value = (value ^ (value >> wp.uint32(13))) * _SECOND
    value = value ^ (value >> wp.uint32(16))
    return 2.0 * wp.float32(value >> wp.uint32(8)) * UNIT - 1.0


@wp.func
def _ease(t: wp.float32) -> wp.float32:
    """Perlin's quintic, flat to second order at both ends."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def _noise(p: wp.vec3, seed: wp.uint32) -> wp.float32:
    """The numbers of a cell's eight corners, eased into each other."""
    x = wp.int32(wp.floor(p[0]))
    y = wp.int32(wp.floor(p[1]))
    z = wp.int32(wp.floor(p[2]))
    a = _ease(p[0] - wp.float32(x))
    b = _ease(p[1] - wp.float32(y))
    c = _ease(p[2] - wp.float32(z))
    low_low = wp.lerp(_number(x, y, z, seed), _number(x + 1, y, z, seed), a)
    high_low = wp.lerp(_number(x, y + 1, z, seed), _number(x + 1, y + 1, z, seed), a)
    low_high = wp.lerp(_number(x, y, z + 1, seed), _number(x + 1, y, z + 1, seed), a)
    high_high = wp.lerp(_number(x, y + 1, z + 1, seed), _number(x + 1, y + 1, z + 1, seed), a)
    return wp.lerp(wp.lerp(low_low, high_low, b), wp.lerp(low_high, high_high, b), c)


@wp.kernel(enable_backward=False)
def add_octaves(
    first: wp.int32,
    points: wp.array[wp.vec3],
    octaves: wp.int32,
    seed: wp.uint32,
    total: wp.array[wp.float32],
) -> None:
    """Sum of noises of halved wavelengths and strengths, each shifted so that their cells do not meet."""
    index = first + wp.tid()
    p = points[index]
    strength = wp.float32(1.0)
    value = wp.float32(0.0)
    for octave in range(octaves):
        value += strength * _noise(p + wp.vec3(17.3 * wp.float32(octave)), seed + wp.uint32(octave))
        p = 2.0 * p
        strength = 0.5 * strength
    total[index] = value


@wp.kernel(enable_backward=False)
def find_spots(
    first: wp.int32,
    points: wp.array[wp.vec3],
    least: wp.float32,
    greatest: wp.float32,
    share: wp.float32,
    seed: wp.uint32,
    strengths: wp.array[wp.float32],
) -> None:
    """The strongest spot at a place among those of the 27 cells about it; cells have size 1."""
    index = first + wp.tid()
    p = points[index]
    x = wp.int32(wp.floor(p[0]))
    y = wp.int32(wp.floor(p[1]))
    z = wp.int32(wp.floor(p[2]))
    best = wp.float32(0.0)
    # a spot keeps to its cell's middle and is smaller than a cell: none beyond the neighbours reaches p
    for step in range(27):
        i = x + step % 3 - 1
        j = y + (step // 3) % 3 - 1
        k = z + step // 9 - 1
        # a cell's numbers are drawn with seeds of their own: whether it has a spot, where, and how large
        if _number(i, j, k, seed + wp.uint32(4)) < 2.0 * share - 1.0:
            shift = wp.vec3(
                _number(i, j, k, seed),
                _number(i, j, k, seed + wp.uint32(1)),
                _number(i, j, k, seed + wp.uint32(2)),
            )
            middle = wp.vec3(wp.float32(i) + 0.5, wp.float32(j) + 0.5, wp.float32(k) + 0.5) + 0.35 * shift
            radius = least + (greatest - least) * (0.5 + 0.5 * _number(i, j, k, seed + wp.uint32(3)))
            best = wp.max(best, wp.clamp(1.4 - 1.4 * wp.length(p - middle) / radius, 0.0, 1.0))
    strengths[index] = best
