"""Small scenes of Gaussians and the cameras before them."""

import math

import torch

from samira_warp.geometry.camera import Camera


def turned_camera(device, width, height):
    """A metre from the origin, and a little to its side."""
    angle = 0.2
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor(
        [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    )
    pose[:3, 3] = torch.tensor([0.02, -0.03, 1.0])
    return Camera(pose.to(device), 1.2 * width, 1.2 * width, width / 2, height / 2, width, height)


def straight_camera(device, width, height, focal=60.0):
    """At the origin, looking along z."""
    return Camera(torch.eye(4, device=device), focal, focal, width / 2, height / 2, width, height)


def cloud(generator, device, count=200, channels=4):
    """Gaussians about the origin, for `turned_camera`."""
    means = 0.25 * torch.randn(count, 3, generator=generator)
    return _gaussians(generator, device, means, 0.03, (0.0, 1.0), channels)


def block(generator, device, count, *, extent=(0.3, 0.3), scale=0.03, opacity=(0.0, 1.0), channels=3):
    """Gaussians about the point at one metre, up to ``extent`` metres to the sides and 0.5 to the back and
    front, for `straight_camera`."""
    place = 2 * torch.rand(count, 3, generator=generator) - 1
    means = place * torch.tensor([*extent, 0.5]) + torch.tensor([0.0, 0.0, 1.0])
    return _gaussians(generator, device, means, scale, opacity, channels)


def _gaussians(generator, device, means, scale, opacity, channels):
    """Means, quaternions, scales, opacities and features."""
    count = len(means)
    quaternions = torch.randn(count, 4, generator=generator)
    scales = scale * torch.exp(0.6 * torch.randn(count, 3, generator=generator))
    opacities = opacity[0] + (opacity[1] - opacity[0]) * torch.rand(count, generator=generator)
    features = torch.randn(count, channels, generator=generator)
    return [tensor.to(device) for tensor in (means, quaternions, scales, opacities, features)]
