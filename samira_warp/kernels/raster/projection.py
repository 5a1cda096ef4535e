"""EWA projection: 3D Gaussians to ellipses on the image plane, and the adjoint.

With p = W mu + t the mean in camera space and J the Jacobian of the pinhole projection at p, the 2D
covariance is

    Sigma' = J W Sigma W' J' + LOW_PASS I = M M' + LOW_PASS I,   M = J W R S  (2 x 3)

and the conic K is its inverse. Working with M rather than Sigma keeps the determinant positive in float32: by
Lagrange's identity det Sigma' = |m0 x m1|^2 + LOW_PASS (|m0|^2 + |m1|^2) + LOW_PASS^2, a sum of positive
terms.

The low-pass is the pixel's own square: what a pixel shows is the mean over it. It spreads a Gaussian, so its
opacity falls by sqrt(det M M' / det Sigma'), and what it adds to the image stays what it was: pictures of
any size average to the same (Mip-Splatting's argument, Yu et al. 2024).
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.ellipse import touches, visible_sigma
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import LOW_PASS, NEAR_PLANE
from samira_warp.support.validation import check_tensors

GRAIN = 1024
"""Gaussians that are worth a thread."""

DETERMINANT_MAX = wp.constant(1.0e30)
"""Pixels^4; beyond it (some 10^7 pixels across) products of conic entries underflow in float32, and the
Gaussian is culled."""

if TYPE_CHECKING:
    mat23 = Any
else:
    mat23 = wp.types.matrix(shape=(2, 3), dtype=wp.float32)


class Projection(NamedTuple):
    """N Gaussians as seen by a camera; every tensor is zero where ``visible`` is False.

    Attributes:
        means2d: (N, 2) float32, pixels from the top left corner of the image; pixel centres lie at +0.5.
        depths: (N,) float32, metres along the camera's z axis.
        conics: (N, 3) float32, inverse 2D covariance as (xx, xy, yy), pixels^-2, LOW_PASS added before the
            inversion.
        opacities: (N,) float32, what is left of them when the low-pass has spread the Gaussians.
        visible: (N,) bool: finite, in front of NEAR_PLANE, and alpha reaches ALPHA_MIN somewhere between the
            image's pixel centres.
    """

    means2d: Tensor
    depths: Tensor
    conics: Tensor
    opacities: Tensor
    visible: Tensor


def project(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
) -> Projection:
    """Project Gaussians through a pinhole camera; differentiable in all but the camera.

    In the Jacobian, x/z and y/z are held to 1.3 times the view's half extent (as 3DGS does), because the
    linearisation explodes far off screen; the gradient follows the clamp. Gaussians that cannot be seen, or
    are not finite, get zeros and zero gradients.

    Args:
        means: (N, 3) float32, world space, metres.
        quaternions: (N, 4) float32 (w, x, y, z), of any length but zero.
        scales: (N, 3) float32 standard deviations along the local axes, metres.
        opacities: (N,) float32 in 0..1. A Gaussian without area in the image, a needle or a point, has none.
        camera: The view; its transform is on the same device.

    Raises:
        UserError: If a shape, dtype or device is wrong.
    """
    check_tensors(
        ("means", means, ("N", 3)),
        ("quaternions", quaternions, ("N", 4)),
        ("scales", scales, ("N", 3)),
        ("opacities", opacities, ("N",)),
        ("camera.world_to_camera", camera.world_to_camera, (4, 4)),
    )
    return project_unchecked(means, quaternions, scales, opacities, camera)


def project_unchecked(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
) -> Projection:
    """`project`, of tensors that were looked at."""
    return Projection(
        *_Project.apply(*(values.contiguous() for values in (means, quaternions, scales, opacities)), camera)
    )


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
    ) -> tuple[Tensor, ...]:
        count = means.shape[0]
        means2d, conics = means.new_zeros(count, 2), means.new_zeros(count, 3)
        depths, spread = means.new_zeros(count), means.new_zeros(count)
        visible = torch.zeros(count, dtype=torch.bool, device=means.device)
        pose = camera.world_to_camera.contiguous()
        lens, size = _lens(camera), wp.vec2(float(camera.width), float(camera.height))
        inputs = (means, quaternions, scales, opacities, pose, *lens, size)
        launch_range(_project, count, *inputs, means2d, depths, conics, spread, visible, grain=GRAIN)
        ctx.save_for_backward(means, quaternions, scales, opacities, pose, visible)
        ctx.camera = camera
        ctx.mark_non_differentiable(visible)
        return means2d, depths, conics, spread, visible

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_means2d: Tensor, grad_depths: Tensor, grad_conics: Tensor, grad_spread: Tensor, _: None
    ) -> tuple[Tensor | None, ...]:
        *gaussians, pose, visible = ctx.saved_tensors
        grad_outputs = [grad.contiguous() for grad in (grad_means2d, grad_depths, grad_conics, grad_spread)]
        grad_inputs = [torch.zeros_like(tensor) for tensor in gaussians]
        inputs = (*gaussians, pose, *_lens(ctx.camera), visible)
        launch_range(_project_adjoint, len(visible), *inputs, *grad_outputs, *grad_inputs, grain=GRAIN)
        return *grad_inputs, None


class _Lens(NamedTuple):
    """A camera's intrinsics as the kernels take them.

    Attributes:
        focal: Focal lengths, pixels.
        principal: Principal point, pixels.
        low: Least (x/z, y/z) that the Jacobian may see.
        high: The greatest.
    """

    focal: wp.vec2
    principal: wp.vec2
    low: wp.vec2
    high: wp.vec2


def _lens(camera: Camera) -> _Lens:
    return _lens_of(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)


@functools.lru_cache(maxsize=64)
def _lens_of(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> _Lens:
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    return _Lens(
        wp.vec2(fx, fy),
        wp.vec2(cx, cy),
        wp.vec2(-cx / fx - margin_x, -cy / fy - margin_y),
        wp.vec2((width - cx) / fx + margin_x, (height - cy) / fy + margin_y),
    )


@wp.func
def _rotation(unit: wp.vec4) -> wp.mat33:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = unit[0], unit[1], unit[2], unit[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@wp.func
def _rotation_adjoint(unit: wp.vec4, grad_R: wp.mat33) -> wp.vec4:
    """Gradient of the unit quaternion from that of its rotation matrix."""
    w, x, y, z = unit[0], unit[1], unit[2], unit[3]
    # the antisymmetric part of grad_R, which turns, and twice the symmetric one off the diagonal
    turn_x, turn_y, turn_z = (
        grad_R[2, 1] - grad_R[1, 2],
        grad_R[0, 2] - grad_R[2, 0],
        grad_R[1, 0] - grad_R[0, 1],
    )
    xy, xz, yz = grad_R[0, 1] + grad_R[1, 0], grad_R[0, 2] + grad_R[2, 0], grad_R[1, 2] + grad_R[2, 1]
    return 2.0 * wp.vec4(
        x * turn_x + y * turn_y + z * turn_z,
        w * turn_x + y * xy + z * xz - 2.0 * x * (grad_R[1, 1] + grad_R[2, 2]),
        w * turn_y + x * xy + z * yz - 2.0 * y * (grad_R[0, 0] + grad_R[2, 2]),
        w * turn_z + x * xz + y * yz - 2.0 * z * (grad_R[0, 0] + grad_R[1, 1]),
    )


@wp.func
def _view_rotation(pose: wp.array2d[wp.float32]) -> wp.mat33:
    """W of world_to_camera."""
    return wp.mat33(
        pose[0, 0], pose[0, 1], pose[0, 2],
        pose[1, 0], pose[1, 1], pose[1, 2],
        pose[2, 0], pose[2, 1], pose[2, 2],
    )  # fmt: skip


@wp.func
def _view_translation(pose: wp.array2d[wp.float32]) -> wp.vec3:
    """The last column t of world_to_camera."""
    return wp.vec3(pose[0, 3], pose[1, 3], pose[2, 3])


@wp.func
def _slopes(point: wp.vec3, low: wp.vec2, high: wp.vec2) -> wp.vec2:
    """(x/z, y/z), clamped for the Jacobian."""
    return wp.vec2(
        wp.clamp(point[0] / point[2], low[0], high[0]), wp.clamp(point[1] / point[2], low[1], high[1])
    )


@wp.func
def _jacobian(depth: wp.float32, slopes: wp.vec2, focal: wp.vec2) -> mat23:
    """J at a point of that depth and those (clamped) slopes, pixels per metre."""
    x, y = focal[0] / depth, focal[1] / depth
    return mat23(x, 0.0, -x * slopes[0], 0.0, y, -y * slopes[1])


@wp.func
def _determinant(m0: wp.vec3, m1: wp.vec3) -> wp.float32:
    """Det (M M' + LOW_PASS I) for the rows of M, free of cancellation."""
    return (
        wp.length_sq(wp.cross(m0, m1))
        + wp.static(LOW_PASS) * (wp.length_sq(m0) + wp.length_sq(m1))
        + wp.static(LOW_PASS**2)
    )


@wp.func
def _kept(m0: wp.vec3, m1: wp.vec3) -> wp.float32:
    """sqrt(det M M' / det (M M' + LOW_PASS I)): what the low-pass leaves of an opacity."""
    return wp.sqrt(wp.length_sq(wp.cross(m0, m1)) / _determinant(m0, m1))


@wp.func
def _conic(m0: wp.vec3, m1: wp.vec3) -> wp.vec3:
    """K = (M M' + LOW_PASS I)^-1 as (xx, xy, yy)."""
    low_pass = wp.static(LOW_PASS)
    return wp.vec3(wp.length_sq(m1) + low_pass, -wp.dot(m0, m1), wp.length_sq(m0) + low_pass) / _determinant(
        m0, m1
    )


@wp.kernel(enable_backward=False)
def _project(
    first: wp.int32,
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    pose: wp.array2d[wp.float32],
    focal: wp.vec2,
    principal: wp.vec2,
    low: wp.vec2,
    high: wp.vec2,
    size: wp.vec2,
    means2d: wp.array[wp.vec2],
    depths: wp.array[wp.float32],
    conics: wp.array[wp.vec3],
    spread: wp.array[wp.float32],
    visible: wp.array[wp.bool],
) -> None:
    i = first + wp.tid()
    W = _view_rotation(pose)
    point = W * means[i] + _view_translation(pose)
    # a comparison with NaN is false: written so that NaN culls
    if not (point[2] > wp.static(NEAR_PLANE) and wp.isfinite(point)):
        return

    # the ellipse, before its inversion: a Gaussian that would overflow there is culled
    R = _rotation(wp.normalize(quaternions[i]))
    M = _jacobian(point[2], _slopes(point, low, high), focal) * W * R * wp.diag(scales[i])
    if not (
        _determinant(M[0], M[1]) < DETERMINANT_MAX
        and wp.length_sq(quaternions[i]) > 0.0
        and wp.isfinite(quaternions[i])
    ):
        return

    # what the low-pass leaves of it has to reach ALPHA_MIN
    opacity = opacities[i] * _kept(M[0], M[1])
    sigma = visible_sigma(opacity)
    if not (sigma >= 0.0):
        return

    # seen only if the ellipse meets the rectangle between the image's outermost pixel centres
    mean = wp.vec2(focal[0] * point[0] / point[2], focal[1] * point[1] / point[2]) + principal
    conic = _conic(M[0], M[1])
    half = wp.vec2(0.5, 0.5)
    if not (wp.isfinite(mean) and touches(mean, conic, sigma, half, size - half)):
        return

    means2d[i] = mean
    depths[i] = point[2]
    conics[i] = conic
    spread[i] = opacity
    visible[i] = True


@wp.kernel(enable_backward=False)
def _project_adjoint(
    first: wp.int32,
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[wp.float32],
    pose: wp.array2d[wp.float32],
    focal: wp.vec2,
    principal: wp.vec2,
    low: wp.vec2,
    high: wp.vec2,
    visible: wp.array[wp.bool],
    grad_means2d: wp.array[wp.vec2],
    grad_depths: wp.array[wp.float32],
    grad_conics: wp.array[wp.vec3],
    grad_spread: wp.array[wp.float32],
    grad_means: wp.array[wp.vec3],
    grad_quaternions: wp.array[wp.vec4],
    grad_scales: wp.array[wp.vec3],
    grad_opacities: wp.array[wp.float32],
) -> None:
    i = first + wp.tid()
    if not visible[i]:
        return

    # the forward pass again: less to compute than to keep
    W = _view_rotation(pose)
    point = W * means[i] + _view_translation(pose)
    unit = wp.normalize(quaternions[i])
    R = _rotation(unit)
    slopes = _slopes(point, low, high)
    J = _jacobian(point[2], slopes, focal)
    RS = R * wp.diag(scales[i])
    M = J * W * RS

    # the adjoint, first to M: dSigma' = -K G K for the symmetric gradient G of K, and dM = 2 dSigma' M
    conic = _conic(M[0], M[1])
    grad_conic = grad_conics[i]
    K = wp.mat22(conic[0], conic[1], conic[1], conic[2])
    G = wp.mat22(grad_conic[0], 0.5 * grad_conic[1], 0.5 * grad_conic[1], grad_conic[2])
    kept = _kept(M[0], M[1])
    grad_opacities[i] = kept * grad_spread[i]
    # d log kept = (M M')^-1 M - K M, as a product: the two are all but equal where the ellipse is large
    fading = kept * opacities[i] * grad_spread[i] * wp.static(LOW_PASS)
    grad_M = -2.0 * (K * G * K) * M + fading * (K * _area_adjoint(M))

    # from M = J W R S to scales and quaternion; a quaternion's length has no gradient, for it is normalised
    grad_RS = wp.transpose(J * W) * grad_M
    grad_R = grad_RS * wp.diag(scales[i])
    grad_scales[i] = wp.vec3(
        R[0, 0] * grad_RS[0, 0] + R[1, 0] * grad_RS[1, 0] + R[2, 0] * grad_RS[2, 0],
        R[0, 1] * grad_RS[0, 1] + R[1, 1] * grad_RS[1, 1] + R[2, 1] * grad_RS[2, 1],
        R[0, 2] * grad_RS[0, 2] + R[1, 2] * grad_RS[1, 2] + R[2, 2] * grad_RS[2, 2],
    )
    grad_unit = _rotation_adjoint(unit, grad_R)
    grad_quaternions[i] = (grad_unit - unit * wp.dot(unit, grad_unit)) / wp.length(quaternions[i])

    # to the mean by three ways: the Jacobian's, the pixel's and the depth's
    grad_J = grad_M * wp.transpose(W * RS)
    grad_point = _jacobian_adjoint(point, slopes, focal, low, high, grad_J) + _pinhole_adjoint(
        point, focal, grad_means2d[i]
    )
    grad_means[i] = wp.transpose(W) * (grad_point + wp.vec3(0.0, 0.0, grad_depths[i]))


@wp.func
def _area_adjoint(M: mat23) -> mat23:
    """Gradient (M M')^-1 M of log |m0 x m1|, free of cancellation."""
    area = wp.cross(M[0], M[1])
    first = wp.cross(M[1], area) / wp.length_sq(area)
    second = wp.cross(area, M[0]) / wp.length_sq(area)
    return mat23(first[0], first[1], first[2], second[0], second[1], second[2])


@wp.func
def _pinhole_adjoint(point: wp.vec3, focal: wp.vec2, grad_pixel: wp.vec2) -> wp.vec3:
    """Gradient of the camera-space point from that of its pixel."""
    x, y = grad_pixel[0] * focal[0] / point[2], grad_pixel[1] * focal[1] / point[2]
    return wp.vec3(x, y, -(x * point[0] + y * point[1]) / point[2])


@wp.func
def _jacobian_adjoint(
    point: wp.vec3, slopes: wp.vec2, focal: wp.vec2, low: wp.vec2, high: wp.vec2, grad_J: mat23
) -> wp.vec3:
    """Gradient of the camera-space point from that of the Jacobian; a clamped slope passes none."""
    z = point[2]
    x, y = focal[0] / z, focal[1] / z
    grad_z = (
        -(x * (grad_J[0, 0] - slopes[0] * grad_J[0, 2]) + y * (grad_J[1, 1] - slopes[1] * grad_J[1, 2])) / z
    )
    grad_u, grad_v = -x * grad_J[0, 2], -y * grad_J[1, 2]
    u, v = point[0] / z, point[1] / z
    if u < low[0] or u > high[0]:
        grad_u = wp.float32(0.0)
    if v < low[1] or v > high[1]:
        grad_v = wp.float32(0.0)
    return wp.vec3(grad_u / z, grad_v / z, grad_z - (grad_u * u + grad_v * v) / z)
