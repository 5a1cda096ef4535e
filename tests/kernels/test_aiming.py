"""Directions of pixels in a light's axes: against their specification, and what they are for."""

from dataclasses import replace

import pytest
import torch
from kernels.scenes import turned_camera

from samira_warp.kernels.shading.aiming import aim
from samira_warp.reference.shading import aiming as reference
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.errors import UserError

WIDTH, HEIGHT = 11, 7

ROUNDING = 1e-6
"""Sixteen roundings of float32, 6e-8 each, of components of unit vectors."""


def pixels(device):
    """Unit normals and coverage: bare, just covered, below the least coverage, and in between."""
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(WIDTH * HEIGHT, 3, generator=generator), dim=1)
    alpha = torch.rand(WIDTH * HEIGHT, 1, generator=generator) * 0.9 + 0.1
    alpha[:5], alpha[5], alpha[6] = 0.0, COVERED_ALPHA, 0.5 * COVERED_ALPHA
    return normal.to(device), alpha.to(device)


@pytest.mark.parametrize("rotate", [0.0, 70.0, -200.0])
def test_directions_are_those_of_the_specification(rotate, device):
    (normal, alpha), camera = pixels(device), turned_camera(device, WIDTH, HEIGHT)
    exact = replace(camera, world_to_camera=camera.world_to_camera.double())
    ours = aim(normal, alpha, camera, rotate=rotate)
    theirs = reference.aim(normal.double(), alpha.double(), exact, rotate=rotate)
    for mine, right in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine.double(), right, rtol=0, atol=ROUNDING)
    bare = alpha[:, 0] < COVERED_ALPHA
    assert int(bare.sum()) == 6
    assert not ours.view[bare].any()
    assert not ours.normal[bare].any()


def test_a_light_that_is_not_turned_leaves_normals_to_the_bit(device):
    normal, alpha = pixels(device)
    aimed = aim(normal, alpha, turned_camera(device, WIDTH, HEIGHT), rotate=0.0)
    assert torch.equal(aimed.normal, torch.where(alpha >= COVERED_ALPHA, normal, 0.0))


def test_a_normal_and_the_view_turn_together(device):
    """What is mirrored at the normal, which shading looks up, is turned as they are."""
    (normal, alpha), camera = pixels(device), turned_camera(device, WIDTH, HEIGHT)
    at_rest, turned = (aim(normal, alpha, camera, rotate=rotate) for rotate in (0.0, 30.0))
    cosines = [(aimed.view * aimed.normal).sum(dim=1) for aimed in (at_rest, turned)]
    torch.testing.assert_close(*cosines, rtol=0, atol=ROUNDING)


def test_another_image_is_refused():
    camera = turned_camera("cpu", WIDTH, HEIGHT)
    with pytest.raises(UserError, match="11 x 7 pixels of the camera"):
        aim(torch.zeros(76, 3), torch.zeros(76, 1), camera, rotate=0.0)
