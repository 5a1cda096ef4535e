"""EWA projection: 3D Gaussians to ellipses on the image plane, and the adjoint.

With p = W mu + t the mean in camera space and J the Jacobian of the pinhole projection at p, the 2D
covariance is

    Sigma' = J W Sigma W' J' + LOW_PASS I = M M' + LOW_PASS I,   M = J W R S  (2 x 3)

and the conic K is its inverse. Working with M rather than Sigma keeps the determinant positive in float32: by
Lagrange's identity det Sigma' = |m0 x m1|^2 + LOW_PASS (|m0|^2 + |m1|^2) + LOW_PASS^2, a sum of positive
terms.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.ellipse import pair, touches, visible_sigma
from samira_warp.kernels.runtime import launch_range
from samira_warp.support.constants import LOW_PASS, NEAR_PLANE
from samira_warp.support.validation import check_tensor

GRAIN = 1024
"""Gaussians that are worth a thread."""

DETERMINANT_MAX = wp.constant(1.0e30)
"""Pixels^4; beyond it (some 10^7 pixels across) products of conic entries underflow in float32, and the
Gaussian is culled."""

mat23 = wp.types.matrix(shape=(2, 3), dtype=wp.float32)


class Projection(NamedTuple):
    """N Gaussians as seen by a camera; every tensor is zero where ``visible`` is False.

    Attributes:
        means2d: (N, 2) float32, pixels from the top left corner of the image; pixel centres lie at +0.5.
        depths: (N,) float32, metres along the camera's z axis.
        conics: (N, 3) float32, inverse 2D covariance as (xx, xy, yy), pixels^-2, LOW_PASS added before the
            inversion.
        visible: (N,) bool: finite, in front of NEAR_PLANE, and alpha reaches ALPHA_MIN somewhere between the
            image's pixel centres.
    """

    means2d: Tensor
    depths: Tensor
    conics: Tensor
    visible: Tensor


def project(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
) -> Projection:
    """Project Gaussians through a pinhole camera; differentiable in means, quaternions and scales.

    In the Jacobian, x/z and y/z are held to 1.3 times the view's half extent (as 3DGS does), because the
    linearisation explodes far off screen; the gradient follows the clamp. Gaussians that cannot be seen, or
    are not finite, get zeros and zero gradients.

    Args:
        means: (N, 3) float32, world space, metres.
        quaternions: (N, 4) float32 (w, x, y, z), of any length but zero.
        scales: (N, 3) float32 standard deviations along the local axes, metres.
        opacities: (N,) float32 in 0..1; they decide what is visible and get no gradient here.
        camera: The view; its transform is on the same device.

    Raises:
        UserError: If a shape, dtype or device is wrong.
    """
    device = means.device
    count = means.shape[0]
    check_tensor("means", means, shape=("N", 3))
    check_tensor("quaternions", quaternions, shape=(count, 4), device=device)
    check_tensor("scales", scales, shape=(count, 3), device=device)
    check_tensor("opacities", opacities, shape=(count,), device=device)
    check_tensor("camera.world_to_camera", camera.world_to_camera, shape=(4, 4), device=device)
    return Projection(
        *_Project.apply(means.contiguous(), quaternions.contiguous(), scales.contiguous(), opacities, camera)
    )


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
    ) -> tuple[Tensor, ...]:
        count = means.shape[0]
        means2d, depths, conics = means.new_zeros(count, 2), means.new_zeros(count), means.new_zeros(count, 3)
        visible = torch.zeros(count, dtype=torch.bool, device=means.device)
        pose = camera.world_to_camera.contiguous()
        size = pair(camera.width, camera.height)
        inputs = (means, quaternions, scales, opacities.contiguous(), pose, *_intrinsics(camera), size)
        launch_range(_project, count, *inputs, means2d, depths, conics, visible, grain=GRAIN)
        ctx.save_for_backward(means, quaternions, scales, pose, visible)
        ctx.camera = camera
        ctx.mark_non_differentiable(visible)
        return means2d, depths, conics, visible

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_means2d: Tensor, grad_depths: Tensor, grad_conics: Tensor, _: None
    ) -> tuple[Tensor | None, ...]:
        means, quaternions, scales, pose, visible = ctx.saved_tensors
        outputs = [torch.zeros_like(means), torch.zeros_like(quaternions), torch.zeros_like(scales)]
        gradients = [gradient.contiguous() for gradient in (grad_means2d, grad_depths, grad_conics)]
        inputs = (means, quaternions, scales, pose, *_intrinsics(ctx.camera), visible)
        launch_range(_project_adjoint, means.shape[0], *inputs, *gradients, *outputs, grain=GRAIN)
        return *outputs, None, None


def _intrinsics(camera: Camera) -> tuple[Any, Any, Any, Any]:
    """Focal lengths, principal point, and the least and greatest (x/z, y/z) that the Jacobian may see."""
    return _intrinsic_pairs(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)


@functools.lru_cache(maxsize=64)
def _intrinsic_pairs(
    fx: float, fy: float, cx: float, cy: float, width: int, height: int
) -> tuple[Any, Any, Any, Any]:
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    low = pair(-cx / fx - margin_x, -cy / fy - margin_y)
    high = pair((width - cx) / fx + margin_x, (height - cy) / fy + margin_y)
    return pair(fx, fy), pair(cx, cy), low, high


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
def _rotation_adjoint(unit: wp.vec4, g: wp.mat33) -> wp.vec4:
    """Gradient of the unit quaternion from the gradient g of its rotation matrix."""
    w, x, y, z = unit[0], unit[1], unit[2], unit[3]
    return 2.0 * wp.vec4(
        x * (g[2, 1] - g[1, 2]) + y * (g[0, 2] - g[2, 0]) + z * (g[1, 0] - g[0, 1]),
        w * (g[2, 1] - g[1, 2])
        + y * (g[0, 1] + g[1, 0])
        + z * (g[0, 2] + g[2, 0])
        - 2.0 * x * (g[1, 1] + g[2, 2]),
        w * (g[0, 2] - g[2, 0])
        + x * (g[0, 1] + g[1, 0])
        + z * (g[1, 2] + g[2, 1])
        - 2.0 * y * (g[0, 0] + g[2, 2]),
        w * (g[1, 0] - g[0, 1])
        + x * (g[0, 2] + g[2, 0])
        + y * (g[1, 2] + g[2, 1])
        - 2.0 * z * (g[0, 0] + g[1, 1]),
    )


@wp.func
def _view(pose: wp.array2d[wp.float32]) -> wp.mat33:
    """W, the rotation of world_to_camera."""
    return wp.mat33(
        pose[0, 0],
        pose[0, 1],
        pose[0, 2],
        pose[1, 0],
        pose[1, 1],
        pose[1, 2],
        pose[2, 0],
        pose[2, 1],
        pose[2, 2],
    )


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
    visible: wp.array[wp.bool],
) -> None:
    i = first + wp.tid()
    W = _view(pose)
    point = W * means[i] + wp.vec3(pose[0, 3], pose[1, 3], pose[2, 3])
    sigma = visible_sigma(opacities[i])
    # a comparison with NaN is false: written so that NaN culls
    if not (point[2] > wp.static(NEAR_PLANE) and wp.isfinite(point) and sigma >= 0.0):
        return
    R = _rotation(wp.normalize(quaternions[i]))
    M = _jacobian(point[2], _slopes(point, low, high), focal) * W * R * wp.diag(scales[i])
    if not (
        _determinant(M[0], M[1]) < DETERMINANT_MAX
        and wp.length_sq(quaternions[i]) > 0.0
        and wp.isfinite(quaternions[i])
    ):
        return
    mean = wp.vec2(focal[0] * point[0] / point[2], focal[1] * point[1] / point[2]) + principal
    conic = _conic(M[0], M[1])
    half = wp.vec2(0.5, 0.5)
    if not (wp.isfinite(mean) and touches(mean, conic, sigma, half, size - half)):
        return
    means2d[i] = mean
    depths[i] = point[2]
    conics[i] = conic
    visible[i] = True


@wp.kernel(enable_backward=False)
def _project_adjoint(
    first: wp.int32,
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    pose: wp.array2d[wp.float32],
    focal: wp.vec2,
    principal: wp.vec2,
    low: wp.vec2,
    high: wp.vec2,
    visible: wp.array[wp.bool],
    grad_means2d: wp.array[wp.vec2],
    grad_depths: wp.array[wp.float32],
    grad_conics: wp.array[wp.vec3],
    grad_means: wp.array[wp.vec3],
    grad_quaternions: wp.array[wp.vec4],
    grad_scales: wp.array[wp.vec3],
) -> None:
    i = first + wp.tid()
    if not visible[i]:
        return
    W = _view(pose)
    point = W * means[i] + wp.vec3(pose[0, 3], pose[1, 3], pose[2, 3])
    unit = wp.normalize(quaternions[i])
    R = _rotation(unit)
    slopes = _slopes(point, low, high)
    J = _jacobian(point[2], slopes, focal)
    RS = R * wp.diag(scales[i])
    M = J * W * RS

    # dSigma' = -K G K with G the symmetric gradient of K, then dM = 2 dSigma' M
    conic = _conic(M[0], M[1])
    g = grad_conics[i]
    K = wp.mat22(conic[0], conic[1], conic[1], conic[2])
    grad_M = -2.0 * (K * wp.mat22(g[0], 0.5 * g[1], 0.5 * g[1], g[2]) * K) * M
    grad_RS = wp.transpose(J * W) * grad_M
    grad_J = grad_M * wp.transpose(W * RS)

    s = scales[i]
    grad_R = grad_RS * wp.diag(s)
    grad_scales[i] = wp.vec3(
        R[0, 0] * grad_RS[0, 0] + R[1, 0] * grad_RS[1, 0] + R[2, 0] * grad_RS[2, 0],
        R[0, 1] * grad_RS[0, 1] + R[1, 1] * grad_RS[1, 1] + R[2, 1] * grad_RS[2, 1],
        R[0, 2] * grad_RS[0, 2] + R[1, 2] * grad_RS[1, 2] + R[2, 2] * grad_RS[2, 2],
    )
    grad_unit = _rotation_adjoint(unit, grad_R)
    grad_quaternions[i] = (grad_unit - unit * wp.dot(unit, grad_unit)) / wp.length(quaternions[i])
    grad_point = _jacobian_adjoint(point, slopes, focal, low, high, grad_J) + _pinhole_adjoint(
        point, focal, grad_means2d[i]
    )
    grad_means[i] = wp.transpose(W) * (grad_point + wp.vec3(0.0, 0.0, grad_depths[i]))


@wp.func
def _pinhole_adjoint(point: wp.vec3, focal: wp.vec2, g: wp.vec2) -> wp.vec3:
    """Gradient of the camera-space point from the gradient g of its pixel."""
    x, y = g[0] * focal[0] / point[2], g[1] * focal[1] / point[2]
    return wp.vec3(x, y, -(x * point[0] + y * point[1]) / point[2])


@wp.func
def _jacobian_adjoint(
    point: wp.vec3, slopes: wp.vec2, focal: wp.vec2, low: wp.vec2, high: wp.vec2, g: mat23
) -> wp.vec3:
    """Gradient of the camera-space point from the gradient g of the Jacobian; a clamped slope passes none."""
    z = point[2]
    x, y = focal[0] / z, focal[1] / z
    grad_z = -(x * (g[0, 0] - slopes[0] * g[0, 2]) + y * (g[1, 1] - slopes[1] * g[1, 2])) / z
    grad_u, grad_v = -x * g[0, 2], -y * g[1, 2]
    u, v = point[0] / z, point[1] / z
    if u < low[0] or u > high[0]:
        grad_u = wp.float32(0.0)
    if v < low[1] or v > high[1]:
        grad_v = wp.float32(0.0)
    return wp.vec3(grad_u / z, grad_v / z, grad_z - (grad_u * u + grad_v * v) / z)
