"""Bright parts of a light taken out of it: power is kept, and directions are where the light is."""

import math

import pytest
import torch

from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light import Environment
from samira_warp.light.bright_spots import SPREAD_RADIUS, divide


def power(cubemap):
    areas = texel_solid_angles(cubemap.shape[1], dtype=torch.float64)[..., None]
    return (cubemap.double() * areas).sum(dim=(0, 1, 2))


def lit(*places, size=64, ambient=0.05):
    """A dim sky with some lit texels."""
    cubemap = torch.full((6, size, size, 3), ambient)
    for face, row, column, value in places:
        cubemap[face, row, column] = torch.tensor([1.0, 0.8, 0.5]) * value
    return cubemap


def test_a_uniform_light_has_no_bright_parts():
    divided = divide(torch.ones(6, 64, 64, 3))
    assert divided.spots is None
    assert (divided.rest == 1).all()


def test_power_is_kept():
    cubemap = lit((4, 10, 20, 900.0), (4, 10, 21, 700.0), (0, 50, 3, 400.0))
    divided = divide(cubemap)
    # float32 sums of 32 and of 24,576 positive terms
    total = divided.spots.powers.double().sum(dim=0) + power(divided.rest)
    torch.testing.assert_close(total, power(cubemap), rtol=1e-5, atol=0)
    assert float(divided.rest.max()) == pytest.approx(0.05)


def test_a_sun_becomes_directions_within_two_degrees_of_it():
    divided = divide(lit((2, 30, 31, 2000.0)))
    used = divided.spots.powers.sum(dim=1) > 0
    assert 1 < int(used.sum()) <= 32
    sun = texel_directions(64)[2, 30, 31]
    cosines = divided.spots.directions[used] @ sun
    assert float(cosines.min()) > math.cos(SPREAD_RADIUS * 1.01)
    assert (divided.spots.directions[~used] == 0).all()
    mean = (divided.spots.powers[used, :1] * divided.spots.directions[used]).sum(dim=0)
    assert float(torch.nn.functional.cosine_similarity(mean, sun, dim=0)) > math.cos(math.radians(0.2))


def test_two_lamps_share_the_directions_by_their_power():
    divided = divide(lit((0, 32, 32, 3000.0), (1, 32, 32, 1000.0)))
    right = divided.spots.directions[:, 0] > 0
    held = divided.spots.powers[:, 0]
    assert float(held[right].sum() / held.sum()) == pytest.approx(0.75, abs=1e-5)


def test_an_environment_divides_its_light_and_keeps_its_irradiance():
    cubemap = lit((2, 30, 31, 2000.0))
    light = Environment.from_cubemaps(cubemap, cubemap).filtered()
    assert light.spots is not None
    total = light.spots.powers.double().sum(dim=0) + power(light.radiance)
    torch.testing.assert_close(total, power(cubemap), rtol=1e-5, atol=0)
    turned = light.turned(30.0).exposed(2.0)
    assert turned.spots is light.spots
