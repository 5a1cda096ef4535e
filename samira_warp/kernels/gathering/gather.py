"""A fixed sparse linear map with K entries a row, and its adjoint through the transpose.

UV position maps (three vertices a texel), samples of UV maps (four texels a Gaussian) and dilation (one texel
a texel) are such maps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.gathering import gather_cpu
from samira_warp.kernels.gathering.gather_cpu import gather_group, gather_row
from samira_warp.kernels.gathering.grouping import group_by
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.errors import UserError
from samira_warp.support.validation import FLOATS, check_ids, check_tensor, check_tensors

GRAIN = 8192
"""Outputs that are worth a thread."""


@dataclass(frozen=True, eq=False)
class GatherTable:
    """Row m of the result is the sum over k of weights[m, k] * values[indices[m, k]].

    The transpose lists, for each source, the rows that use it; entries of weight 0 are in neither direction,
    so what they point at may be anything, NaN included.

    Attributes:
        indices: (M, K) int32 rows of the source.
        weights: (M, K) float32.
        sources: S, number of source rows.
        transpose_offsets: (S + 1,) int32.
        transpose_rows: (E,) int32, rows of the result, by source and then ascending.
        transpose_weights: (E,) float32.
    """

    indices: Tensor
    weights: Tensor
    sources: int
    transpose_offsets: Tensor
    transpose_rows: Tensor
    transpose_weights: Tensor

    def __post_init__(self) -> None:
        check_tensors(
            ("indices", self.indices, ("M", "K"), torch.int32),
            ("weights", self.weights, ("M", "K")),
            ("transpose_offsets", self.transpose_offsets, (self.sources + 1,), torch.int32),
            ("transpose_rows", self.transpose_rows, ("E",), torch.int32),
            ("transpose_weights", self.transpose_weights, ("E",)),
        )

    @classmethod
    def build(cls, indices: Tensor, weights: Tensor, *, sources: int) -> GatherTable:
        """Check the entries and transpose them.

        Args:
            indices: (M, K) integers from 0 to ``sources`` - 1.
            weights: (M, K) float, on the same device.
            sources: S.

        Raises:
            UserError: The shapes differ, or an index is out of range.
        """
        check_ids("indices", indices, shape=("M", "K"), count=sources)
        check_tensor("weights", weights, shape=indices.shape, dtype=FLOATS, device=indices.device)
        indices = indices.to(torch.int32).contiguous()
        weights = weights.detach().to(torch.float32).contiguous()
        entries = weights.flatten().nonzero().squeeze(1)
        by_source = group_by(indices.flatten()[entries], sources)
        entries = entries[by_source.members]
        return cls(
            indices=indices,
            weights=weights,
            sources=sources,
            transpose_offsets=by_source.offsets,
            transpose_rows=(entries // max(indices.shape[1], 1)).to(torch.int32),
            transpose_weights=weights.flatten()[entries],
        )

    @property
    def rows(self) -> int:
        """M, number of rows of the result."""
        return self.indices.shape[0]

    def to(self, device: torch.device | str) -> GatherTable:
        """The same map on ``device``."""
        tensors: dict[str, Any] = {
            name: value.to(device) for name, value in vars(self).items() if isinstance(value, Tensor)
        }
        return replace(self, **tensors)


def gather(values: Tensor, table: GatherTable) -> Tensor:
    """Apply a sparse map, differentiably in ``values``.

    Args:
        values: (S, C) float32.
        table: The map, on the same device.

    Returns:
        (M, C) float32.

    Raises:
        UserError: ``values`` has another shape, dtype or device than the table needs.
    """
    check_tensor("values", values, shape=(table.sources, "C"), device=table.indices.device)
    return _Gather.apply(values, table)


def bilinear_table(uv: Tensor, *, width: int, height: int) -> GatherTable:
    """The map that samples a UV image bilinearly, its border held beyond the outer texel centres.

    Texel (row, column) has its centre at u = (column + 0.5) / W, v = 1 - (row + 0.5) / H; the image is
    flattened to (H * W, C).

    Args:
        uv: (N, 2) float, u to the right and v up, on [0, 1].
        width: W, texels.
        height: H, texels.

    Raises:
        UserError: ``uv`` has another shape or is not finite.
    """
    check_tensor("uv", uv, shape=("N", 2), dtype=FLOATS)
    if not bool(uv.isfinite().all()):
        raise UserError("uv", expected="finite coordinates", found="NaN or infinity")
    x = (uv[:, 0] * width - 0.5).clamp(0, width - 1)
    y = ((1 - uv[:, 1]) * height - 0.5).clamp(0, height - 1)
    left, top = x.long().clamp(max=max(width - 2, 0)), y.long().clamp(max=max(height - 2, 0))
    right, bottom = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    x, y = x - left, y - top
    indices = torch.stack(
        [top * width + left, top * width + right, bottom * width + left, bottom * width + right], dim=1
    )
    weights = torch.stack([(1 - y) * (1 - x), (1 - y) * x, y * (1 - x), y * x], dim=1)
    return GatherTable.build(indices, weights, sources=width * height)


class _Gather(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, table: GatherTable) -> Tensor:
        ctx.table = table
        result, values = values.new_empty(table.rows, values.shape[1]), values.contiguous()
        if values.device.type == "cpu":
            entries = table.indices.view(-1), table.weights.view(-1)
            launch_range(
                gather_row,
                table.rows,
                table.indices.shape[1],
                *entries,
                values,
                result,
                grain=gather_cpu.GRAIN,
            )
        else:
            launch_range(_gather, result.numel(), table.indices, table.weights, values, result, grain=GRAIN)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_result: Tensor) -> tuple[Tensor, None]:
        table: GatherTable = ctx.table
        grad_values = grad_result.new_empty(table.sources, grad_result.shape[1])
        # the adjoint of a gather is the gather along the transpose: each source sums in one order, without
        # atomics
        transpose = (table.transpose_offsets, table.transpose_rows, table.transpose_weights)
        arguments = (*transpose, grad_result.contiguous(), grad_values)
        if grad_values.device.type == "cpu":
            launch_range(gather_group, table.sources, *arguments, grain=gather_cpu.GRAIN)
        else:
            launch_range(_gather_transposed, grad_values.numel(), *arguments, grain=GRAIN)
        return grad_values, None


@wp.kernel(enable_backward=False)
def _gather(
    first: wp.int32,
    indices: wp.array2d[wp.int32],
    weights: wp.array2d[wp.float32],
    values: wp.array2d[wp.float32],
    result: wp.array2d[wp.float32],
) -> None:
    """One value of the result: a row and a channel."""
    index = first + wp.tid()
    row = index // result.shape[1]
    channel = index - row * result.shape[1]
    total = wp.float32(0.0)
    for k in range(indices.shape[1]):
        weight = weights[row, k]
        if weight != 0.0:
            total += weight * values[indices[row, k], channel]
    result[row, channel] = total


@wp.kernel(enable_backward=False)
def _gather_transposed(
    first: wp.int32,
    offsets: wp.array[wp.int32],
    rows: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    grad_result: wp.array2d[wp.float32],
    grad_values: wp.array2d[wp.float32],
) -> None:
    """One value of the source's gradient: a source row and a channel."""
    index = first + wp.tid()
    source = index // grad_values.shape[1]
    channel = index - source * grad_values.shape[1]
    total = wp.float32(0.0)
    for entry in range(offsets[source], offsets[source + 1]):
        total += weights[entry] * grad_result[rows[entry], channel]
    grad_values[source, channel] = total
