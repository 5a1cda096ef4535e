import math

import torch

from samira_warp.kernels.cubemap.filter import irradiance
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light.harmonics import (
    FUNCTIONS,
    harmonics,
    irradiance_functions,
    mean_radiance,
    uniform_harmonics,
)


def test_they_are_orthonormal():
    size = 64
    values = harmonics(texel_directions(size, dtype=torch.float64))
    areas = texel_solid_angles(size, dtype=torch.float64)
    products = torch.einsum("fija,fijb,ij->ab", values, values, areas)
    # the midpoint rule over texels of 1/32 errs by some (1/32)^2 / 4 of products that bend twice over a face
    torch.testing.assert_close(products, torch.eye(FUNCTIONS, dtype=torch.float64), atol=1e-3, rtol=0)


def test_their_order_and_signs():
    directions = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8], [-0.2, 0.9, 0.4]]), dim=1)
    x, y, z = directions.double().unbind(dim=1)
    expected = [x**0, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y]
    found = harmonics(directions.double())
    for column, values in enumerate(expected):
        ratios = found[:, column] / values
        assert ratios.min() > 0
        torch.testing.assert_close(ratios[0], ratios[1])


def test_irradiance_is_the_filters(generator):
    light = torch.randn(FUNCTIONS, 3, generator=generator)
    cubemap = (harmonics(texel_directions(32)) @ light).contiguous()
    found = irradiance_functions(texel_directions(16)) @ light
    # the filter sums 32 x 32 texels a face: the midpoint rule errs by (1/16)^2 / 4 of values of about one
    torch.testing.assert_close(found, irradiance(cubemap, size=16), atol=4e-3, rtol=0)


def test_a_uniform_light_of_one_is_irradiance_of_one():
    light = torch.zeros(FUNCTIONS, 1)
    light[0] = 2.0 * math.sqrt(math.pi)
    assert torch.allclose(irradiance_functions(texel_directions(2)) @ light, torch.ones(1))
    assert torch.allclose(mean_radiance(light), torch.ones(1))


def test_uniform_light_gives_its_radiance():
    radiance = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    normals = torch.nn.functional.normalize(torch.eye(3, dtype=torch.float64) + 0.3, dim=1)
    found = irradiance_functions(normals) @ uniform_harmonics(radiance)
    torch.testing.assert_close(found, radiance.expand(3, 3))
