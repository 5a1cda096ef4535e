"""Wrinkles turn normals, along the atlas's axes, and nothing else."""

from dataclasses import replace

import pytest
import torch
from scipy.spatial.transform import Rotation
from subjects import camera, parameters, small_avatar, small_canonical

from samira_warp.avatar.wrinkles import face_tangents, wrinkled
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.nets import MotionSettings

SMALL = MotionSettings(
    width=8, region_width=4, condition_width=8, bands=3, displacement_bands=3, wrinkles=True
)


@pytest.fixture
def avatar():
    """With wrinkles that differ from texel to texel."""
    avatar = small_avatar(motion=SMALL)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        torch.nn.init.normal_(avatar.motion.slopes.weight, std=0.3)
        torch.nn.init.normal_(avatar.motion.slopes.bias, std=0.3)
    return avatar


def test_a_plane_has_the_axes_that_it_was_laid_out_by(generator):
    """u grows along one direction of a plane and v along another, at other rates and not at right angles."""
    canonical = small_canonical()
    turn = torch.from_numpy(Rotation.random(rng=3).as_matrix()).float()
    along_u, along_v = turn[:, 0], 0.6 * turn[:, 0] + 0.8 * turn[:, 1]
    places = torch.rand(30, 2, generator=generator)
    faces = torch.arange(30, dtype=torch.int32).view(10, 3)
    vertices = 0.5 * places[:, :1] * along_u + 0.2 * places[:, 1:] * along_v
    topology, atlas = MeshTopology.build(faces, 30), replace(canonical.atlas, vt=places, ft=faces)
    tangents = face_tangents(vertices, topology, atlas)
    found = tangents @ triangle_frames(vertices, topology).rotation.mT
    # corners of 0.1 m by 2^-24 of it, over edges that may be a hundredth of the face
    torch.testing.assert_close(found[:, 0], along_u.expand(10, 3), rtol=0, atol=2e-4)
    torch.testing.assert_close(found[:, 1], along_v.expand(10, 3), rtol=0, atol=2e-4)


def test_a_face_without_area_in_the_atlas_has_no_tangents():
    canonical = small_canonical()
    atlas = replace(canonical.atlas, vt=torch.zeros_like(canonical.atlas.vt))
    assert (face_tangents(canonical.vertices, canonical.topology, atlas) == 0).all()


def test_a_slope_turns_a_normal_by_its_angle():
    normals = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 2.0]])
    tangents = torch.eye(3)[:2].expand(2, 2, 3)
    turned = wrinkled(normals, torch.tensor([[1.0, 0.0], [0.0, -(3.0**0.5)]]), tangents)
    expected = torch.tensor([[0.5**0.5, 0.0, 0.5**0.5], [0.0, -(0.75**0.5), 0.5]])
    torch.testing.assert_close(torch.nn.functional.normalize(turned, dim=1), expected)


def test_without_slopes_the_picture_is_the_same(device):
    plain, able = small_avatar(device=device), small_avatar(motion=SMALL, device=device)
    frame, view = parameters(1, device=device), camera(32, device=device)
    with torch.no_grad():
        able.motion.load_state_dict(plain.motion.state_dict(), strict=False)
        # a normal of unit length is normalised once more
        assert (able.render(frame, view).image - plain.render(frame, view).image).abs().max() < 1e-5


def test_nothing_but_normals_turns(avatar):
    frame = parameters(2)
    with torch.no_grad():
        wrinkled_motion = avatar.move(frame)
        torch.nn.init.zeros_(avatar.motion.slopes.weight)
        torch.nn.init.zeros_(avatar.motion.slopes.bias)
        smooth_motion = avatar.move(frame)
    for name in ("means", "quaternions", "scales"):
        found, expected = (getattr(motion.gaussians, name) for motion in (wrinkled_motion, smooth_motion))
        assert torch.equal(found, expected)
    cosines = (wrinkled_motion.gaussians.normals * smooth_motion.gaussians.normals).sum(dim=1)
    assert cosines.min() < 0.97
    assert wrinkled_motion.slopes.abs().max() < 1.0
    assert (smooth_motion.slopes == 0).all()


def test_wrinkles_turn_with_the_head(avatar):
    """The same expression in a head that is turned: the same slopes, and normals that are turned as well."""
    frame = parameters(2)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2])
    root = turn * Rotation.from_rotvec(frame.rotations[0].numpy())
    turned_root = torch.from_numpy(root.as_rotvec()).float()
    rotations = torch.cat([turned_root[None], frame.rotations[1:]])
    with torch.no_grad():
        # conditions would tell the turn: the network is to give the same slopes here
        avatar.statistics.pose_scale.zero_()
        before, after = avatar.move(frame), avatar.move(replace(frame, rotations=rotations))
    torch.testing.assert_close(after.slopes, before.slopes, rtol=0, atol=1e-4)
    expected = before.gaussians.normals @ torch.from_numpy(turn.as_matrix()).float().T
    # displacement in the head's frame rounds otherwise when it is turned, and slopes with it
    torch.testing.assert_close(after.gaussians.normals, expected, rtol=0, atol=1e-3)


def test_the_gradient_of_a_slope_is_the_difference_quotient(avatar):
    frame, weights = (
        parameters(2),
        torch.randn(len(avatar.gaussians), 3, generator=torch.Generator().manual_seed(4)),
    )
    bias = avatar.motion.slopes.bias

    def value():
        return (avatar.move(frame).gaussians.normals * weights).double().sum()

    (gradient,) = torch.autograd.grad(value(), bias)
    for index in range(2):
        with torch.no_grad():
            step = 1e-2
            bias[index] += step
            above = value()
            bias[index] -= 2 * step
            below = value()
            bias[index] += step
        # second differences: third derivatives of order one times the step squared
        assert float((above - below) / (2 * step)) == pytest.approx(
            float(gradient[index]), rel=2e-2, abs=2e-2
        )
