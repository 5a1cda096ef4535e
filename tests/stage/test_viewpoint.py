"""Cameras that stand about a head: where they are, what they see in the middle, which way is up."""

import math

import pytest
import torch
from subjects import camera, parameters, small_avatar, small_canonical

from samira_warp.avatar import DrivingFrame
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.stage import Background, HeadPlace, Orbit, Scene, Viewpoint, plan_shots
from samira_warp.stage.viewpoint import distance_to, head_center

LENS = camera(40, height=30)

AT_REST = HeadPlace(torch.tensor([0.1, 0.2, 0.3]), torch.eye(3))


@pytest.mark.parametrize(
    ("yaw", "pitch", "towards", "up"),
    [
        (0, 0, (0, 0, 1), (0, 1, 0)),
        (90, 0, (1, 0, 0), (0, 1, 0)),  # at the head's left, which is +x
        (180, 0, (0, 0, -1), (0, 1, 0)),
        (-90, 0, (-1, 0, 0), (0, 1, 0)),
        (0, 90, (0, 1, 0), (0, 0, -1)),  # straight above: the back of the head is up
        (0, -90, (0, -1, 0), (0, 0, 1)),
        (90, 30, (math.cos(math.pi / 6), 0.5, 0), (-0.5, math.cos(math.pi / 6), 0)),
    ],
)
def test_where_it_stands_and_which_way_is_up(yaw, pitch, towards, up):
    placed = Viewpoint(yaw, pitch, 2.0).camera(AT_REST, LENS)
    # float32 rounds metres to 1e-7
    torch.testing.assert_close(
        placed.center, AT_REST.center + 2.0 * torch.tensor(towards).float(), atol=1e-6, rtol=0
    )
    rotation = placed.world_to_camera[:3, :3]
    torch.testing.assert_close(-rotation[1], torch.tensor(up).float(), atol=1e-6, rtol=0)
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), atol=1e-6, rtol=0)
    assert torch.linalg.det(rotation) > 0
    assert distance_to(placed, AT_REST) == pytest.approx(2.0, abs=1e-6)


def test_the_heads_centre_is_in_the_middle_of_the_lens():
    shifted = LENS.__class__(LENS.world_to_camera, 50.0, 60.0, 3.0, 4.0, 40, 30)
    placed = Viewpoint(25.0, -10.0, 0.8).camera(AT_REST, shifted)
    assert (placed.fx, placed.fy, placed.width, placed.height) == (50.0, 60.0, 40, 30)
    seen = placed.world_to_camera @ torch.cat([AT_REST.center, torch.ones(1)])
    torch.testing.assert_close(seen, torch.tensor([0.0, 0.0, 0.8, 1.0]), atol=1e-6, rtol=0)
    assert (placed.cx, placed.cy) == (20.0, 15.0)


def test_a_camera_goes_with_its_head():
    """A posed head is seen from a viewpoint as the same face unposed is."""
    canonical, frame = small_canonical(), parameters(1)
    posed, rest = canonical.pose(frame), canonical.pose(canonical.rig.rest())
    turn = axis_angle_to_matrix(torch.tensor([0.2, -0.9, 0.4]))
    view = Viewpoint(40.0, 15.0, 1.2)
    place = HeadPlace.of(canonical, posed)
    local = posed.in_head_frame()
    for moved, where in [
        (local, HeadPlace.of(canonical, rest)),
        (posed.vertices, place),
        (posed.vertices @ turn.T, HeadPlace(turn @ place.center, turn @ place.axes)),
    ]:
        transform = view.camera(where, LENS).world_to_camera
        seen = moved @ transform[:3, :3].T + transform[:3, 3]
        if moved is local:
            expected = seen
        torch.testing.assert_close(seen, expected, atol=1e-5, rtol=0)


def test_the_centre_is_that_of_what_the_head_carries():
    canonical = small_canonical()
    center = head_center(canonical)
    low, high = canonical.vertices.aminmax(dim=0)
    assert ((low < center) & (center < high)).all()
    # jaw and eyes are the head's: it is the middle of face and skull, not of the neck's rest
    rig = canonical.rig
    carried = rig.weights[:, 1:].sum(dim=1) > 0.5
    box = canonical.vertices[carried]
    torch.testing.assert_close(center, 0.5 * (box.amin(dim=0) + box.amax(dim=0)), atol=0, rtol=0)


@pytest.mark.parametrize(("width", "height"), [(40, 30), (30, 40)])
def test_the_field_of_view_is_that_of_the_longer_side(width, height):
    lens = camera(width, height=height)
    assert lens.field_of_view == pytest.approx(2 * math.degrees(math.atan(20 / lens.fx)))
    wide = lens.with_field_of_view(90.0)
    assert wide.field_of_view == pytest.approx(90.0)
    assert wide.fx == wide.fy == pytest.approx(20.0)
    assert (wide.cx, wide.cy, wide.width, wide.height) == (lens.cx, lens.cy, width, height)
    assert lens.with_field_of_view(lens.field_of_view).fx == pytest.approx(lens.fx)


def frame_called(name):
    return DrivingFrame(name, parameters(0), camera(32), "test")


def test_shots_from_a_camera_that_goes_round():
    orbit = Orbit(0.5, Viewpoint(30.0, 10.0, 1.0), AT_REST, LENS)
    (held,) = plan_shots([frame_called("a")], orbit=orbit, frames_per_second=8.0)
    assert [picture.name for picture in held.pictures] == [f"a_{index:04d}" for index in range(4)]
    assert held.frame.camera is held.pictures[0].camera
    for index, picture in enumerate(held.pictures):
        expected = Viewpoint(30.0 + 90.0 * index, 10.0, 1.0).camera(AT_REST, LENS)
        assert torch.equal(picture.camera.world_to_camera, expected.world_to_camera)
        assert picture.degrees == 0.0
    moving = plan_shots([frame_called(name) for name in "ab"], orbit=orbit, frames_per_second=8.0)
    assert [shot.pictures[0].name for shot in moving] == ["a", "b"]
    for shot, expected in zip(moving, held.pictures, strict=False):
        assert torch.equal(shot.frame.camera.world_to_camera, expected.camera.world_to_camera)


def test_light_and_camera_go_round_at_their_own_speeds():
    orbit = Orbit(1.0, Viewpoint(0.0, 0.0, 1.0), AT_REST, LENS)
    (held,) = plan_shots([frame_called("a")], turntable=0.5, orbit=orbit, frames_per_second=8.0)
    assert [picture.degrees for picture in held.pictures] == [90.0 * index for index in range(8)]
    last = held.pictures[-1].camera
    assert torch.equal(last.world_to_camera, orbit.camera(315.0).world_to_camera)


def test_another_camera_sees_the_same_posed_head():
    scene = Scene(small_avatar().requires_grad_(False), (), Background("white"))
    frame = frame_called("a")
    view, light = scene.view(frame), scene.light(scene.avatar.light.environment())
    other = Viewpoint(70.0, 20.0, 1.0).camera(AT_REST, LENS)
    moved = scene.seen_from(view, other)
    assert moved.motion is view.motion
    assert moved.occlusion is view.occlusion
    expected = scene.relight(scene.view(frame._replace(camera=other)), light)
    assert torch.equal(scene.relight(moved, light).image, expected.image)
