"""Rotations turned by axis-angle vectors: the rotational half of Eq. final_motion."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from samira_warp.kernels.runtime import launch_range
from samira_warp.support.validation import check_tensors

GRAIN = 2048
"""Rotations that are worth a thread."""

_SMALL_ANGLE = wp.constant(0.02)
"""Radians; below it sines over angles are taken from their series, whose next terms are less than float32
rounds: a^4 / 3840 of s, and a^4 / 53760 of its slope."""


def turn(quaternions: Tensor, turns: Tensor) -> Tensor:
    """Rotations followed by turns about axes of the same space: quat(v) q.

    Args:
        quaternions: (N, 4) float32 q (w, x, y, z), of any length.
        turns: (N, 3) float32 axis-angle vectors v, radians.

    Returns:
        (N, 4) float32 of the lengths of ``quaternions``, differentiable in both.

    Raises:
        UserError: A wrong shape, dtype or device.
    """
    check_tensors(
        ("quaternions", quaternions, ("N", 4)),
        ("turns", turns, (len(quaternions), 3)),
        device=quaternions.device,
    )
    return _Turn.apply(quaternions, turns)


class _Turn(torch.autograd.Function):
    """One rotation an index, forward and backward."""

    @staticmethod
    def forward(ctx: Any, quaternions: Tensor, turns: Tensor) -> Tensor:
        quaternions, turns = quaternions.contiguous(), turns.contiguous()
        turned = torch.empty_like(quaternions)
        launch_range(_turn, len(turned), quaternions, turns, turned, grain=GRAIN)
        ctx.save_for_backward(quaternions, turns)
        return turned

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_turned: Tensor) -> tuple[Tensor, ...]:
        inputs = ctx.saved_tensors
        grads = tuple(torch.empty_like(tensor) for tensor in inputs)
        launch_range(_turn_adjoint, len(grad_turned), *inputs, grad_turned.contiguous(), *grads, grain=GRAIN)
        return grads


@wp.struct
class _Turning:
    """The unit quaternion (c, s v) of v: c = cos(a / 2), s = sin(a / 2) / a, a = |v|; and (ds/da) / a."""

    cosine: wp.float32
    sine: wp.float32
    slope: wp.float32


@wp.func
def _turning(v: wp.vec3) -> _Turning:
    squared = wp.length_sq(v)
    angle = wp.sqrt(squared)
    found = _Turning()
    found.cosine = wp.cos(0.5 * angle)
    if angle < _SMALL_ANGLE:
        found.sine = 0.5 - squared / 48.0
        found.slope = squared / 960.0 - 1.0 / 24.0
    else:
        found.sine = wp.sin(0.5 * angle) / angle
        found.slope = (0.5 * found.cosine - found.sine) / squared
    return found


@wp.func
def _product(a: wp.vec4, b: wp.vec4) -> wp.vec4:
    """Hamilton product of (w, x, y, z)."""
    u, v = wp.vec3(a[1], a[2], a[3]), wp.vec3(b[1], b[2], b[3])
    vector = a[0] * v + b[0] * u + wp.cross(u, v)
    return wp.vec4(a[0] * b[0] - wp.dot(u, v), vector[0], vector[1], vector[2])


@wp.func
def _conjugate(q: wp.vec4) -> wp.vec4:
    return wp.vec4(q[0], -q[1], -q[2], -q[3])


@wp.func
def _as_quaternion(turning: _Turning, v: wp.vec3) -> wp.vec4:
    s = turning.sine
    return wp.vec4(turning.cosine, s * v[0], s * v[1], s * v[2])


@wp.kernel(enable_backward=False)
def _turn(
    first: wp.int32,
    quaternions: wp.array[wp.vec4],
    turns: wp.array[wp.vec3],
    turned: wp.array[wp.vec4],
) -> None:
    """One rotation."""
    index = first + wp.tid()
    v = turns[index]
    turned[index] = _product(_as_quaternion(_turning(v), v), quaternions[index])


@wp.kernel(enable_backward=False)
def _turn_adjoint(
    first: wp.int32,
    quaternions: wp.array[wp.vec4],
    turns: wp.array[wp.vec3],
    grad_turned: wp.array[wp.vec4],
    grad_quaternions: wp.array[wp.vec4],
    grad_turns: wp.array[wp.vec3],
) -> None:
    """One rotation: <e q, g> = <q, e* g> = <e, g q*>, then from e = (c, s v) to v."""
    index = first + wp.tid()
    v = turns[index]
    turning = _turning(v)
    grad = grad_turned[index]
    grad_quaternions[index] = _product(_conjugate(_as_quaternion(turning, v)), grad)
    by_turn = _product(grad, _conjugate(quaternions[index]))
    by_vector = wp.vec3(by_turn[1], by_turn[2], by_turn[3])

    # dc/dv = -s v / 2, and ds/dv = (ds/da) v / a
    along = turning.slope * wp.dot(by_vector, v) - 0.5 * turning.sine * by_turn[0]
    grad_turns[index] = turning.sine * by_vector + along * v
