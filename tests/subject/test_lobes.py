"""Directions that the ray caster's surface draws, against the density that it says they have."""

import math

import numpy as np
import pytest
import torch
import warp as wp
from lobe_probe import densities, directions

from samira_warp.kernels.runtime import launch_range
from samira_warp.light.equirect import equirect_directions


def lobes(tilt, roughness, *, height=256, count=1 << 16):
    """Directions and solid angles of a panorama, the density there, and drawn directions, of a surface whose
    bump tilts by degrees."""
    tilted, viewed = math.radians(tilt), math.radians(30.0)
    normal, view = (
        wp.vec3(math.sin(tilted), 0.0, math.cos(tilted)),
        wp.vec3(-math.sin(viewed), 0.0, math.cos(viewed)),
    )
    lights = equirect_directions(height).flatten(0, 1).contiguous()
    edges = torch.cos(torch.linspace(0.0, math.pi, height + 1, dtype=torch.float64))
    angles = ((edges[:-1] - edges[1:]) * math.pi / height).repeat_interleave(2 * height)
    density, drawn = torch.empty(len(lights)), torch.empty(count, 3)
    launch_range(densities, len(lights), lights, normal, view, roughness, density, grain=256)
    launch_range(directions, count, 11, normal, view, roughness, drawn, grain=256)
    return lights.double(), angles, density.double(), drawn.double()


@pytest.mark.parametrize("tilt", [0.0, 10.0, 25.0])
@pytest.mark.parametrize("roughness", [0.3, 0.46, 0.72])
def test_drawn_directions_have_the_density_that_is_said(tilt, roughness):
    lights, angles, density, drawn = lobes(tilt, roughness)
    # the lobe at roughness 0.3 is some 10 degrees wide, texels are 0.7: the midpoint rule is off by less than
    # their square
    assert float((density * angles).sum()) == pytest.approx(1.0, abs=4e-3)
    for axis in range(3):
        expected = float((density * angles * lights[:, axis]).sum())
        spread = float(drawn[:, axis].std()) / math.sqrt(len(drawn))
        assert abs(float(drawn[:, axis].mean()) - expected) < 4 * spread + 4e-3, axis


def test_some_drawn_directions_lie_below_a_bump():
    """Otherwise nothing above is tested that a tilt would change."""
    *_, drawn = lobes(25.0, 0.72)
    tilted = math.radians(25.0)
    below = drawn.numpy() @ np.array([math.sin(tilted), 0.0, math.cos(tilted)]) < 0
    assert below.mean() > 0.01
