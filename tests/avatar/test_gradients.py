"""Gradients of the whole avatar by finite differences, along directions that involve every entry of an
input."""

from dataclasses import replace

import pytest
import torch
from subjects import SMALL_LIGHT, camera, parameters, pose_of, posed, small_avatar

from samira_warp.head import FLAME_JOINTS

STEP = 2e-3

SHORTER = {"jaw": 3e-4}
"""A triangle between the lips is almost flat when the jaw opens: its normal turns quickly, and a step of 2e-3
is beyond the linear."""


def smooth_state(moved):
    """What describes moved Gaussians without the quaternions' sign, which may flip from one step to the
    next."""
    q = moved.quaternions
    return 10.0 * moved.means, q[:, :, None] * q[:, None, :], moved.normals


def motion_loss(avatar, frame, generator):
    """A random linear function of where the Gaussians are: no pixel, no threshold."""
    with torch.no_grad():
        weights = [
            torch.randn(value.shape, generator=generator, dtype=torch.float64)
            for value in smooth_state(avatar.move(frame).gaussians)
        ]

    def loss(driven):
        return sum(
            (w * value.double()).sum()
            for w, value in zip(weights, smooth_state(avatar.move(driven).gaussians), strict=True)
        )

    return loss


def central_difference(function, value, direction, step):
    return (function(value + step * direction) - function(value - step * direction)) / (2 * step)


@pytest.mark.parametrize("name", ["expression", *FLAME_JOINTS, "translation"])
def test_motion_gradient_to_head_parameters(name, generator):
    avatar = small_avatar(perturb=0.3, light_sizes=SMALL_LIGHT)
    frame = parameters(4)
    loss = motion_loss(avatar, frame, generator)

    def changed(value):
        return posed(frame, **{name: value}) if name in FLAME_JOINTS else replace(frame, **{name: value})

    value = pose_of(frame, name) if name in FLAME_JOINTS else getattr(frame, name)
    leaf = value.clone().requires_grad_()
    loss(changed(leaf)).backward()
    direction = torch.nn.functional.normalize(torch.randn(value.shape, generator=generator), dim=0)
    with torch.no_grad():

        def along(shifted):
            return loss(changed(shifted))

        step = SHORTER.get(name, STEP)
        halves = [float(central_difference(along, value, direction, size)) for size in (step, 2 * step)]
    # Richardson takes out the step's square. What is left is float32's rounding: 200 x 22 terms, each good to
    # 1e-7, add up to 1e-7 * sqrt(4400) = 7e-6 at random, and three times that where roundings agree, over a
    # step
    expected = (4 * halves[0] - halves[1]) / 3
    assert float(leaf.grad @ direction) == pytest.approx(expected, rel=2e-3, abs=2e-5 / step)


@pytest.mark.parametrize("name", ["means", "quaternions", "normals"])
def test_motion_gradient_to_local_gaussians(name, generator):
    avatar = small_avatar(perturb=0.3, light_sizes=SMALL_LIGHT)
    frame = parameters(5)
    loss = motion_loss(avatar, frame, generator)
    parameter = getattr(avatar.gaussians, name)
    loss(frame).backward()
    direction = torch.randn(parameter.shape, generator=generator)
    direction /= direction.norm()
    start = parameter.detach().clone()

    def along(value):
        with torch.no_grad():
            parameter.copy_(value)
            return loss(frame)

    # every Gaussian moves by 1 / sqrt(N): the step may be larger
    expected = float(central_difference(along, start, direction, 0.05))
    assert float((parameter.grad * direction).sum()) == pytest.approx(expected, rel=1e-2, abs=1e-3)


SHADING = ("albedo_logits", "roughness_logits", "specular_logits", "normals")
"""Parameters of the Gaussians in which the image is smooth."""

GEOMETRY = ("means", "log_scales", "quaternions", "opacity_logits")
"""Parameters that move what each Gaussian covers."""


@pytest.mark.parametrize(
    ("names", "tolerance"),
    [
        # the step's square, float32's rounding of an image's loss of 0.1 against differences of 1e-5, and,
        # for normals, the kinks of bilinear lookups at the texels' centres that the step crosses: 1.0 %
        # measured
        (
            [
                *(f"gaussians.{name}" for name in SHADING),
                "light.diffuse",
                "light.specular",
                "response_logits",
            ],
            0.02,
        ),
        # Gaussians are cut where their alpha is 1/255. What comes in at that rim as they grow or move is in
        # the difference and not in the gradient: with r^2 = 2 s^2 ln(255 o) it is (1/255) r^2 / (2 s^2 o) = 3
        # % of each one's own, and more where gradients cancel or few pixels lie on a rim.
        ([*(f"gaussians.{name}" for name in GEOMETRY), "motion.residual.bias"], 0.12),
    ],
    ids=["shading", "geometry"],
)
def test_image_gradient_along_itself(names, tolerance, generator):
    """Along the gradient the signal is strongest, and a missing term shows as a wrong length."""
    avatar = small_avatar(perturb=0.2, light_sizes=SMALL_LIGHT)
    frame, view = parameters(6), camera(64)
    target = torch.rand(64, 64, 3, generator=generator)

    def loss():
        return (avatar.render(frame, view).image - target).double().square().mean()

    loss().backward()
    named = dict(avatar.named_parameters())
    for name in names:
        parameter, gradient = named[name], named[name].grad.clone()
        start, direction = parameter.detach().clone(), gradient / gradient.norm()

        def along(value, parameter=parameter):
            with torch.no_grad():
                parameter.copy_(value)
                return loss()

        difference = float(central_difference(along, start, direction, 0.05))
        along(start)
        assert difference == pytest.approx(float(gradient.norm()), rel=tolerance), name
