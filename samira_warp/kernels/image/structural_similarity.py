"""Structural similarity of two pictures (Wang et al. 2004), with its adjoint.

Moments under a Gaussian window are filtered down the columns, turned on their side and filtered down again:
each lane of a vector is a column of its own, and a row's neighbours are the same for all of them.
"""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.caching import cached_tensors
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors

RADIUS, SIGMA = 5, 1.5
"""Pixels: half of the window without its middle, and the Gaussian's deviation."""

WINDOW = 2 * RADIUS + 1

LUMINANCE, CONTRAST = 0.01**2, 0.03**2
"""C_1 and C_2 of a range of 1."""

LANES = 32
"""Columns that are filtered together, four registers of 256 bits: they share the loop's own arithmetic."""

GRAIN = 512
"""Vectors that are worth a thread."""

Lanes = wp.types.vector(length=LANES, dtype=wp.float32)


def structural_similarity(prediction: Tensor, truth: Tensor) -> Tensor:
    """Mean structural similarity over all pixels and channels, borders reflected.

    Differentiable in ``prediction``.

    Args:
        prediction: (H, W, C) float32 on [0, 1], more than RADIUS pixels a side.
        truth: The same, on the same device.

    Returns:
        () float32, at most 1.

    Raises:
        UserError: The pictures are too small, or differ in shape, dtype or device.
    """
    check_tensors(
        ("prediction", prediction, ("H", "W", "C")),
        ("truth", truth, tuple(prediction.shape)),
        device=prediction.device,
    )
    if min(prediction.shape[:2]) <= RADIUS:
        expected = f"more than {RADIUS} pixels a side, half of the window"
        raise UserError("prediction", expected=expected, found=tuple(prediction.shape[:2]))
    return _StructuralSimilarity.apply(prediction, truth)


def window() -> Tensor:
    """(WINDOW,) float64 weights, which sum to 1."""
    weights = torch.exp(-0.5 * (torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float64) / SIGMA) ** 2)
    return weights / weights.sum()


@cached_tensors(16)
def _bands(count: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """(count, WINDOW) weights of the neighbours from -RADIUS to RADIUS of each row, and of the transpose's.

    What the window has beyond a border lies on the rows that are reflected there.
    """
    rows = torch.arange(count)[:, None]
    matrix = torch.zeros(count, count, dtype=torch.float64)
    beyond = (rows + torch.arange(-RADIUS, RADIUS + 1)).abs()
    sources = torch.minimum(beyond, 2 * (count - 1) - beyond)
    matrix.scatter_add_(1, sources, window().expand(count, -1).contiguous())

    def band(of: Tensor) -> Tensor:
        padded = torch.nn.functional.pad(of, (RADIUS, RADIUS))
        return padded.gather(1, rows + torch.arange(WINDOW)).float().to(device)

    return band(matrix), band(matrix.T)


class _StructuralSimilarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, prediction: Tensor, truth: Tensor) -> Tensor:
        height, width, channels = prediction.shape
        ours, theirs = (_lanes(image.detach().flatten(1)) for image in (prediction, truth))
        down, across = (_bands(size, prediction.device)[0] for size in (height, width))
        moments = ours.new_empty(5, *ours.shape)
        launch_range(_moments, moments[0].numel() // LANES, ours, theirs, down, moments, grain=GRAIN)
        turned = _turned(moments, channels=channels, length=width)
        similarity, slopes = turned.new_empty(turned.shape[1:]), turned.new_empty(3, *turned.shape[1:])
        launch_range(
            _similarity, similarity.numel() // LANES, turned, across, similarity, slopes, grain=GRAIN
        )
        ctx.save_for_backward(ours, theirs, slopes)
        ctx.shape = prediction.shape
        return similarity.flatten(1)[:, : height * channels].mean()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_mean: Tensor) -> tuple[Tensor, None]:
        ours, theirs, slopes = ctx.saved_tensors
        height, width, channels = ctx.shape
        down, across = (_bands(size, ours.device)[1] for size in (height, width))
        filtered = torch.empty_like(slopes)
        launch_range(_filter, filtered.numel() // LANES, slopes, across, filtered, grain=GRAIN)
        turned = _turned(filtered, channels=channels, length=height)
        gradient = torch.empty_like(ours)
        launch_range(_gradient, gradient.numel() // LANES, turned, down, ours, theirs, gradient, grain=GRAIN)
        inside = gradient.flatten(1)[:, : width * channels].unflatten(1, (width, channels))
        return inside * (grad_mean / inside.numel()), None


def _lanes(rows: Tensor) -> Tensor:
    """(..., R, L) values as (..., R, P, LANES), zeros after the last."""
    missing = -rows.shape[-1] % LANES
    padded = torch.nn.functional.pad(rows, (0, missing)) if missing else rows
    return padded.contiguous().unflatten(-1, (-1, LANES))


def _turned(fields: Tensor, *, channels: int, length: int) -> Tensor:
    """Fields (F, R, P, LANES) of R rows of ``length`` pixels as those of ``length`` rows of R pixels."""
    pixels = fields.flatten(2)[..., : length * channels].unflatten(2, (length, channels))
    return _lanes(pixels.transpose(1, 2).flatten(2))


@wp.kernel(enable_backward=False)
def _moments(
    first: wp.int32,
    ours: wp.array2d[Lanes],
    theirs: wp.array2d[Lanes],
    band: wp.array2d[wp.float32],
    moments: wp.array3d[Lanes],
) -> None:
    """Means down the columns of x, y, x^2, y^2 and x y, one vector of lanes."""
    index = first + wp.tid()
    row = index // ours.shape[1]
    place = index - row * ours.shape[1]
    x, y, xx, yy, xy = Lanes(), Lanes(), Lanes(), Lanes(), Lanes()
    for source in range(wp.max(row - RADIUS, 0), wp.min(row + RADIUS + 1, ours.shape[0])):
        weight = band[row, source - row + RADIUS]
        a = ours[source, place]
        b = theirs[source, place]
        weighted_a = weight * a
        weighted_b = weight * b
        x += weighted_a
        y += weighted_b
        xx += wp.cw_mul(weighted_a, a)
        yy += wp.cw_mul(weighted_b, b)
        xy += wp.cw_mul(weighted_a, b)
    moments[0, row, place] = x
    moments[1, row, place] = y
    moments[2, row, place] = xx
    moments[3, row, place] = yy
    moments[4, row, place] = xy


@wp.func
def _filtered(
    fields: wp.array3d[Lanes], band: wp.array2d[wp.float32], field: wp.int32, row: wp.int32, place: wp.int32
) -> Lanes:  # type: ignore[valid-type]
    """A field's mean down the columns."""
    total = Lanes()
    for source in range(wp.max(row - RADIUS, 0), wp.min(row + RADIUS + 1, fields.shape[1])):
        total += band[row, source - row + RADIUS] * fields[field, source, place]
    return total


@wp.kernel(enable_backward=False)
def _similarity(
    first: wp.int32,
    moments: wp.array3d[Lanes],
    band: wp.array2d[wp.float32],
    similarity: wp.array2d[Lanes],
    slopes: wp.array3d[Lanes],
) -> None:
    """Similarity of what is under the window, and its slopes along the means of x, x^2 and x y."""
    index = first + wp.tid()
    row = index // similarity.shape[1]
    place = index - row * similarity.shape[1]
    x = _filtered(moments, band, 0, row, place)
    y = _filtered(moments, band, 1, row, place)
    xx = _filtered(moments, band, 2, row, place)
    yy = _filtered(moments, band, 3, row, place)
    xy = _filtered(moments, band, 4, row, place)
    products, squares_x, squares_y = wp.cw_mul(x, y), wp.cw_mul(x, x), wp.cw_mul(y, y)
    luminance, contrast = Lanes(wp.float32(LUMINANCE)), Lanes(wp.float32(CONTRAST))
    two = wp.float32(2.0)
    above_1, above_2 = two * products + luminance, two * (xy - products) + contrast
    below_1 = squares_x + squares_y + luminance
    below_2 = xx - squares_x + yy - squares_y + contrast
    below = wp.cw_mul(below_1, below_2)
    value = wp.cw_div(wp.cw_mul(above_1, above_2), below)
    similarity[row, place] = value
    by_square = wp.cw_div(value, below_2)
    along_x = wp.cw_div(wp.cw_mul(y, above_2 - above_1), below)
    along_x += wp.cw_mul(x, by_square - wp.cw_div(value, below_1))
    slopes[0, row, place] = two * along_x
    slopes[1, row, place] = -by_square
    slopes[2, row, place] = two * wp.cw_div(above_1, below)


@wp.kernel(enable_backward=False)
def _filter(
    first: wp.int32, fields: wp.array3d[Lanes], band: wp.array2d[wp.float32], filtered: wp.array3d[Lanes]
) -> None:
    """Means down the columns of several fields, one vector of lanes."""
    index = first + wp.tid()
    area = fields.shape[1] * fields.shape[2]
    field = index // area
    row = (index - field * area) // fields.shape[2]
    place = index - field * area - row * fields.shape[2]
    filtered[field, row, place] = _filtered(fields, band, field, row, place)


@wp.kernel(enable_backward=False)
def _gradient(
    first: wp.int32,
    slopes: wp.array3d[Lanes],
    band: wp.array2d[wp.float32],
    ours: wp.array2d[Lanes],
    theirs: wp.array2d[Lanes],
    gradient: wp.array2d[Lanes],
) -> None:
    """What the sum of all similarities rises by with a pixel of x."""
    index = first + wp.tid()
    row = index // ours.shape[1]
    place = index - row * ours.shape[1]
    of_mean = _filtered(slopes, band, 0, row, place)
    of_square = _filtered(slopes, band, 1, row, place)
    of_product = _filtered(slopes, band, 2, row, place)
    through_square = wp.float32(2.0) * wp.cw_mul(ours[row, place], of_square)
    gradient[row, place] = of_mean + through_square + wp.cw_mul(theirs[row, place], of_product)
