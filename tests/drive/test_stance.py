"""What is taken over of somebody, as an avatar's pose: signs, joints, and where the head is."""

import pytest
import torch
from scipy.spatial.transform import Rotation
from subjects import camera, parameters, small_canonical, small_template

from samira_warp.avatar import DrivingFrame
from samira_warp.drive.stance import Face, Stance, carrying_joints, joint_places
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head import FLAME_JOINTS

NECK = FLAME_JOINTS.index("neck")


def frames(turning="neck"):
    """Frames in which one joint turns the head, by up to half a radian either way."""
    found = []
    for number, angle in enumerate((-0.5, 0.0, 0.5)):
        moved = parameters(number, turn=0.02)
        moved.rotations[:2] = 0.0
        moved.rotations[FLAME_JOINTS.index(turning)] = torch.tensor([angle, angle, angle])
        found.append(DrivingFrame(str(number), moved, camera(), "train"))
    return found


def stance(**options):
    return Stance.of(small_template(), frames(**options), small_canonical().shape)


def face(turn=(0, 0, 0), shift=(0, 0, 0)):
    template = small_template()
    return Face(
        torch.from_numpy(Rotation.from_rotvec(turn).as_matrix()),
        torch.tensor(shift, dtype=torch.float64),
        torch.zeros(len(template.joint_names), 3, dtype=torch.float64),
        torch.zeros(template.n_expression, dtype=torch.float64),
    )


def head_of(stance, pose):
    """Turn and place of the joint that carries the head, in the world."""
    turns = axis_angle_to_matrix(pose.rotations.double())
    places = joint_places(stance.template, small_canonical().shape)
    place = turns[0] @ (places[NECK] - places[0]) + places[0] + pose.translation.double()
    return turns[0] @ turns[NECK], place


def test_the_frontal_frame_is_taken_and_its_face_is_at_rest():
    found = stance()
    assert found.frame.name == "1"
    assert not found.rest.expression.any()
    assert not found.rest.rotations[2:].any()
    torch.testing.assert_close(found.pose(face()).translation, found.rest.translation)


@pytest.mark.parametrize("turning", ["root", "neck"])
def test_the_joint_that_turned_most_turns_the_head(turning):
    found = stance(turning=turning)
    pose = found.pose(face(turn=(0.1, 0.2, -0.1)))
    moved = (pose.rotations - found.rest.rotations).norm(dim=-1) > 0.05
    assert [FLAME_JOINTS[joint] for joint in moved.nonzero()[:, 0]] == [turning]


@pytest.mark.parametrize("turning", ["root", "neck"])
def test_head_and_place_go_as_the_drivers(turning):
    """Whichever joint turns: the head has the turn, and the joint that carries it the place."""
    found = stance(turning=turning)
    turn, shift = (0.15, -0.3, 0.1), (0.01, -0.02, 0.03)
    before, at = head_of(found, found.rest)
    after, there = head_of(found, found.pose(face(turn, shift)))
    wanted = before @ torch.from_numpy(Rotation.from_rotvec(turn).as_matrix())
    # float32 parameters: 1e-7 of a radian and of a metre, some ten of them
    torch.testing.assert_close(after, wanted, atol=2e-6, rtol=0)
    torch.testing.assert_close(
        there - at, before @ torch.tensor(shift, dtype=torch.float64), atol=2e-6, rtol=0
    )


@pytest.mark.parametrize(
    ("turn", "axis", "way"),
    [((0.2, 0, 0), 1, -1), ((0, 0.2, 0), 0, 1)],
    ids=["x nods down", "y turns to the left, which is +x"],
)
def test_signs(turn, axis, way):
    nose = head_of(stance(), stance().pose(face(turn)))[0][:, 2]
    assert way * nose[axis] > 0.15


def test_z_tilts_to_the_right():
    crown = head_of(stance(), stance().pose(face((0, 0, 0.2))))[0][:, 1]
    assert crown[0] < -0.15, "the head's right is -x"


def test_poses_are_held_to_what_was_seen():
    found = stance()
    far = face(turn=(0, 2.0, 0))
    assert found.pose(far).rotations[NECK, 1] == pytest.approx(0.5)
    assert found.pose(far, clamp=False).rotations[NECK, 1] == pytest.approx(2.0, abs=1e-6)


def test_a_jaw_and_eyes_are_added_to_the_rest():
    rotations = face().rotations.clone()
    rotations[FLAME_JOINTS.index("jaw"), 0] = 0.1
    pose = stance().pose(face()._replace(rotations=rotations), clamp=False)
    assert pose.rotations[FLAME_JOINTS.index("jaw"), 0] == pytest.approx(0.1)


def test_the_joints_that_carry_a_head():
    assert carrying_joints(small_template()) == [0, NECK]
