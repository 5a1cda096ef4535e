"""Slots: where the adjoint of blending leaves a gradient per Gaussian and tile, and their sums.

A Gaussian's slots lie side by side, so each is summed in a fixed order, without atomics, to the same bits on
every run.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.prefetch import AHEAD, prefetch_floats
from samira_warp.kernels.raster.tiles import TileBins
from samira_warp.kernels.runtime import launch_range

GEOMETRY = 6
"""Floats of a gradient before those of its features: mean x, y; conic xx, xy, yy; opacity."""

GRAIN = 2048
"""Gaussians that are worth a thread."""


class SlotGradients(NamedTuple):
    """Gradients by slot, of I intersections.

    Attributes:
        values: (I, R) float32, GEOMETRY floats, then the channels, then what fills the row; R is a multiple
            of 4.
        reached: (I,) bool, whether any pixel saw so far; where not, the values were never written and count
            as 0.
    """

    values: Tensor
    reached: Tensor

    @classmethod
    def allocate(cls, bins: TileBins, channels: int) -> SlotGradients:
        """Room for the gradients of ``bins``, nothing reached."""
        slots = bins.slots.shape[0]
        values = torch.empty(
            slots, -(-(GEOMETRY + channels) // 4) * 4, dtype=torch.float32, device=bins.slots.device
        )
        return cls(values, torch.zeros(slots, dtype=torch.bool, device=values.device))


class GaussianGradients(NamedTuple):
    """Gradients of what `blend` took of N Gaussians: views of one (N, R) tensor.

    Attributes:
        means2d: (N, 2) float32.
        conics: (N, 3) float32.
        opacities: (N,) float32.
        features: (N, C) float32.
    """

    means2d: Tensor
    conics: Tensor
    opacities: Tensor
    features: Tensor


def sum_slots(grad_slots: SlotGradients, bins: TileBins, channels: int) -> GaussianGradients:
    """Sums over each Gaussian's slots."""
    values, reached = grad_slots
    count, width = bins.order.shape[0], values.shape[1]
    totals = values.new_empty(count, width)
    launch_range(_sum_slots, count, bins.order, bins.slot_offsets, values, reached, totals, grain=GRAIN)
    means2d, conics, opacities, features, _ = totals.split(
        (2, 3, 1, channels, width - GEOMETRY - channels), dim=1
    )
    return GaussianGradients(means2d, conics, opacities.squeeze(1), features)


@wp.func_native("""
    float* __restrict__ total = totals.data + (size_t)i * totals.shape[1];
    for (int c = 0; c < totals.shape[1]; ++c) total[c] = 0.0f;
""")
def _clear_row(totals: wp.array2d[wp.float32], i: wp.int32) -> None: ...


@wp.func_native("""
    float* __restrict__ total = totals.data + (size_t)i * totals.shape[1];
    const float* __restrict__ value = values.data + (size_t)slot * totals.shape[1];
    for (int c = 0; c < totals.shape[1]; ++c) total[c] += value[c];
""")
def _add_row(
    totals: wp.array2d[wp.float32], i: wp.int32, values: wp.array2d[wp.float32], slot: wp.int32
) -> None: ...


@wp.kernel(enable_backward=False)
def _sum_slots(
    first: wp.int32,
    order: wp.array[wp.int32],
    slot_offsets: wp.array[wp.int32],
    values: wp.array2d[wp.float32],
    reached: wp.array[wp.bool],
    totals: wp.array2d[wp.float32],
) -> None:
    """Sum the slots of one Gaussian, the Gaussians in the order of depth, in which their slots lie."""
    rank = first + wp.tid()
    # slots are read one after the other, but totals are written anywhere
    prefetch_floats(totals, order[wp.min(rank + AHEAD, order.shape[0] - 1)])
    i = order[rank]
    _clear_row(totals, i)
    for slot in range(slot_offsets[rank], slot_offsets[rank + 1]):
        if reached[slot]:
            _add_row(totals, i, values, slot)
