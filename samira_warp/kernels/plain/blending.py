"""Alpha blending as plain Warp kernels, one thread per pixel.

They are the fast kernels' specification in float32, and the yardstick of their speed. The adjoint adds
atomically, which on a CPU is right on one thread only.
"""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from samira_warp.kernels.raster.blending import Blended
from samira_warp.kernels.raster.slots import GaussianGradients
from samira_warp.kernels.raster.tiles import TILE, TileBins
from samira_warp.kernels.runtime import launch
from samira_warp.support.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

SIGMA_MAX = wp.constant(5.55)
"""ln 255 and a little: beyond it no opacity reaches ALPHA_MIN, and the exponential is not worth taking."""


def blend(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    bins: TileBins,
    gaussians: Tensor,
    *,
    width: int,
    height: int,
) -> Blended:
    """As `samira_warp.kernels.raster.blending.blend`, without gradients.

    ``gaussians`` are those of ``bins``, looked up once.
    """
    blended = Blended(features.new_zeros(height, width, features.shape[1]), features.new_zeros(height, width))
    inputs, lists = (means2d, conics, opacities, features), (bins.tile_offsets, gaussians, bins.columns)
    launch(_blend, _threads(bins), *inputs, *lists, *blended)
    return blended


def blend_adjoint(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    bins: TileBins,
    gaussians: Tensor,
    blended: Blended,
    grad_features: Tensor,
    grad_transmittance: Tensor,
) -> GaussianGradients:
    """Gradients of the means, conics, opacities and features from those of both results."""
    inputs, lists = (means2d, conics, opacities, features), (bins.tile_offsets, gaussians, bins.columns)
    images = (*blended, grad_features, grad_transmittance)
    gradients = GaussianGradients(*(torch.zeros_like(tensor) for tensor in inputs))
    launch(_blend_adjoint, _threads(bins), *inputs, *lists, *images, *gradients)
    return gradients


def _threads(bins: TileBins) -> int:
    return bins.columns * bins.rows * TILE * TILE


@wp.func
def _pixel(thread: wp.int32, columns: wp.int32) -> wp.vec3i:
    """Tile, x and y of a thread: tile by tile, so that neighbouring threads read the same Gaussians."""
    tile = thread / (TILE * TILE)
    local = thread % (TILE * TILE)
    return wp.vec3i(tile, (tile % columns) * TILE + local % TILE, (tile / columns) * TILE + local / TILE)


@wp.func
def _sigma(conic: wp.vec3, d: wp.vec2) -> wp.float32:
    return 0.5 * (conic[0] * d[0] * d[0] + conic[2] * d[1] * d[1]) + conic[1] * d[0] * d[1]


@wp.kernel(enable_backward=False)
def _blend(
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    features: wp.array2d[wp.float32],
    tile_offsets: wp.array[wp.int32],
    gaussians: wp.array[wp.int32],
    columns: wp.int32,
    image: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
) -> None:
    place = _pixel(wp.tid(), columns)
    x, y = place[1], place[2]
    if x >= image.shape[1] or y >= image.shape[0]:
        return
    center = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    T = wp.float32(1.0)
    for entry in range(tile_offsets[place[0]], tile_offsets[place[0] + 1]):
        i = gaussians[entry]
        sigma = _sigma(conics[i], center - means2d[i])
        if sigma > SIGMA_MAX:
            continue
        alpha = wp.min(opacities[i] * wp.exp(-sigma), wp.static(ALPHA_MAX))
        if alpha < wp.static(ALPHA_MIN):
            continue
        weight = alpha * T
        if T - weight < wp.static(TRANSMITTANCE_MIN):
            break
        for c in range(features.shape[1]):
            image[y, x, c] = image[y, x, c] + weight * features[i, c]
        T -= weight
    transmittance[y, x] = T


@wp.kernel(enable_backward=False)
def _blend_adjoint(
    means2d: wp.array[wp.vec2],
    conics: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    features: wp.array2d[wp.float32],
    tile_offsets: wp.array[wp.int32],
    gaussians: wp.array[wp.int32],
    columns: wp.int32,
    image: wp.array3d[wp.float32],
    transmittance: wp.array2d[wp.float32],
    grad_image: wp.array3d[wp.float32],
    grad_transmittance: wp.array2d[wp.float32],
    grad_means2d: wp.array[wp.vec2],
    grad_conics: wp.array[wp.vec3],
    grad_opacities: wp.array[wp.float32],
    grad_features: wp.array2d[wp.float32],
) -> None:
    place = _pixel(wp.tid(), columns)
    x, y = place[1], place[2]
    if x >= image.shape[1] or y >= image.shape[0]:
        return
    center = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    T = wp.float32(1.0)

    # what the gradient still has to meet behind the Gaussian at hand: at first the image times its gradient
    behind = transmittance[y, x] * grad_transmittance[y, x]
    for c in range(features.shape[1]):
        behind += image[y, x, c] * grad_image[y, x, c]

    for entry in range(tile_offsets[place[0]], tile_offsets[place[0] + 1]):
        # the forward pass again, which stops at the same Gaussian
        i = gaussians[entry]
        d = center - means2d[i]
        K = conics[i]
        sigma = _sigma(K, d)
        if sigma > SIGMA_MAX:
            continue
        density = opacities[i] * wp.exp(-sigma)
        alpha = wp.min(density, wp.static(ALPHA_MAX))
        if alpha < wp.static(ALPHA_MIN):
            continue
        weight = alpha * T
        if T - weight < wp.static(TRANSMITTANCE_MIN):
            break

        # of the features, and of the alpha: dL/dalpha = T (f . g) - behind / (1 - alpha)
        dot = wp.float32(0.0)
        for c in range(features.shape[1]):
            dot += features[i, c] * grad_image[y, x, c]
            wp.atomic_add(grad_features, i, c, weight * grad_image[y, x, c])
        behind -= weight * dot
        # none passes the cap
        if density <= wp.static(ALPHA_MAX):
            grad_alpha = T * dot - behind / (1.0 - alpha)
            grad_sigma = -alpha * grad_alpha
            wp.atomic_add(grad_opacities, i, grad_alpha * wp.exp(-sigma))
            wp.atomic_add(
                grad_means2d, i, -grad_sigma * wp.vec2(K[0] * d[0] + K[1] * d[1], K[1] * d[0] + K[2] * d[1])
            )
            wp.atomic_add(
                grad_conics, i, grad_sigma * wp.vec3(0.5 * d[0] * d[0], d[0] * d[1], 0.5 * d[1] * d[1])
            )
        T -= weight
