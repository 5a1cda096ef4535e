"""Spherical harmonics against integrals over many directions."""

import torch

from samira_warp.tracker.harmonics import FUNCTIONS, harmonics, irradiance_functions, uniform

COUNT = 20_000


def directions():
    """A Fibonacci lattice: means of smooth functions to about 1 / COUNT."""
    index = torch.arange(COUNT, dtype=torch.float64) + 0.5
    z = 1 - 2 * index / COUNT
    angle = index * torch.pi * (1 + 5**0.5)
    ring = (1 - z * z).sqrt()
    return torch.stack([ring * angle.cos(), ring * angle.sin(), z], dim=1)


def test_they_are_orthonormal():
    values = harmonics(directions())
    gram = 4 * torch.pi * values.T @ values / COUNT
    torch.testing.assert_close(gram, torch.eye(FUNCTIONS, dtype=torch.float64), rtol=0, atol=1e-3)


def test_irradiance_is_the_integral_over_the_hemisphere():
    sphere = directions()
    normals = torch.nn.functional.normalize(torch.tensor([[0.0, 0.0, 1.0], [0.3, -0.5, 0.8]]).double(), dim=1)
    cosines = (normals @ sphere.T).clamp(min=0.0)
    expected = 4 * torch.pi * cosines @ harmonics(sphere) / COUNT / torch.pi
    # the cosine's kink is sampled to a step of the lattice, 0.01 radians squared
    torch.testing.assert_close(irradiance_functions(normals), expected, rtol=0, atol=1e-3)


def test_uniform_light_gives_its_radiance():
    light = uniform(torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64))
    normals = torch.nn.functional.normalize(torch.randn(5, 3, dtype=torch.float64), dim=1)
    expected = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64).expand(5, 3)
    torch.testing.assert_close(irradiance_functions(normals) @ light, expected)
