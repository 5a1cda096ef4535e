"""Sums over the members of groups, in one order whatever the threads."""

from __future__ import annotations

import warp as wp
from torch import Tensor

from samira_warp.kernels.gathering.grouping import Groups
from samira_warp.kernels.runtime import launch_range

GRAIN = 2048
"""Sums that are worth a thread."""


def sum_groups(values: Tensor, groups: Groups, *, together: int = 1) -> Tensor:
    """Sum the members of each group, in the order of their ids.

    Args:
        values: (B, M, C) float32, contiguous.
        groups: G groups of the M members.
        together: Frames that share a sum: 1, or B for one sum over all frames, one frame after the other.

    Returns:
        (B / together, G, C) float32.
    """
    count = groups.offsets.shape[0] - 1
    # one sum over no frames at all is still a sum
    sums = values.new_empty(1 if together == values.shape[0] else values.shape[0], count, values.shape[2])
    # threes are most of what is summed: as vectors they take half the time
    kernel = _sum_vectors if values.shape[2] == 3 else _sum_values
    launch_range(kernel, sums.shape[0] * count, *groups, values, together, sums, grain=GRAIN)
    return sums


@wp.kernel(enable_backward=False)
def _sum_values(
    first: wp.int32,
    offsets: wp.array[wp.int32],
    members: wp.array[wp.int32],
    values: wp.array3d[wp.float32],
    together: wp.int32,
    sums: wp.array3d[wp.float32],
) -> None:
    """One group, its channels one by one."""
    index = first + wp.tid()
    row = index // sums.shape[1]
    group = index - row * sums.shape[1]
    for channel in range(sums.shape[2]):
        sums[row, group, channel] = 0.0
    for frame in range(row * together, (row + 1) * together):
        for entry in range(offsets[group], offsets[group + 1]):
            for channel in range(sums.shape[2]):
                sums[row, group, channel] += values[frame, members[entry], channel]


@wp.kernel(enable_backward=False)
def _sum_vectors(
    first: wp.int32,
    offsets: wp.array[wp.int32],
    members: wp.array[wp.int32],
    values: wp.array2d[wp.vec3],
    together: wp.int32,
    sums: wp.array2d[wp.vec3],
) -> None:
    """One group of vectors."""
    index = first + wp.tid()
    row = index // sums.shape[1]
    group = index - row * sums.shape[1]
    total = wp.vec3(0.0)
    for frame in range(row * together, (row + 1) * together):
        for entry in range(offsets[group], offsets[group + 1]):
            total += values[frame, members[entry]]
    sums[row, group] = total
