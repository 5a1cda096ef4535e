"""Another subject's parameters as an avatar takes them, against numbers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from data.rigs import SEVEN, with_seven_joints, without_a_jaw
from data.tiny import tiny_template
from subjects import pose_of, small_template

from samira_warp.avatar.driving import Driver, NameMap, PoseRange, match_expressions, match_joints
from samira_warp.head import FLAME_JOINTS, FrameParameters, read_template
from samira_warp.support.errors import UserError

NAMES = ("jawOpen", "browsUp", "smileLeft", "smileRight")


def frame(*, translation=(0, 0, 0), expression=(0, 0, 0, 0), joints=FLAME_JOINTS, **rotations):
    """A frame with some joints turned, by name."""
    assert set(rotations) <= set(joints)
    poses = [rotations.get(name, (0, 0, 0)) for name in joints]
    values = (translation, poses, expression)
    return FrameParameters(*(torch.tensor(value, dtype=torch.float32) for value in values))


def own(**options):
    """A driver of the avatar's own template, whose expressions are four."""
    return replace(Driver.own(small_template()), **options)


def named(*names):
    """The made-up template with names of its own for its expressions, as many as there are names."""
    template = small_template()
    first = template.shapedirs[:, :, : template.n_shape + 1]
    copies = np.repeat(first[:, :, -1:], len(names), axis=2)
    return replace(
        template, shapedirs=np.concatenate([first[:, :, :-1], copies], axis=2), expression_names=names
    )


def numbers(tensor):
    return tensor.tolist()


def same(first, second):
    fields = ("translation", "rotations", "expression")
    return all(torch.equal(getattr(first, name), getattr(second, name)) for name in fields)


def test_a_zero_neutral_without_gain_changes_no_bit():
    driven = frame(
        translation=(0.1, 0.2, 0.3),
        root=(0.1, -3.0, 0.2),
        jaw=(0.3, 0, 0),
        expression=(0.1, -0.7, 3.3, 0.01),
    )
    assert same(own().drive(driven), driven)


def test_expression_and_jaw_are_relative_to_the_drivers_neutral():
    neutral = frame(
        translation=(9, 9, 9),
        root=(9, 9, 9),
        neck=(9, 9, 9),
        jaw=(0.25, 0, -0.5),
        left_eye=(9, 9, 9),
        right_eye=(9, 9, 9),
        expression=(1, 0, -2, 0.5),
    )
    moved = frame(
        translation=(1, 2, 3),
        root=(4, 5, 6),
        neck=(7, 8, 9),
        jaw=(0.5, 0.25, 0),
        left_eye=(1, 2, 3),
        right_eye=(4, 5, 6),
        expression=(1.5, 1, -1, 0.5),
    )
    driven = own(neutral=neutral, gain=2.0).drive(moved)
    # 2 * (moved - neutral); the gain is the expression's alone
    assert numbers(driven.expression) == [1.0, 2.0, 2.0, 0.0]
    assert numbers(pose_of(driven, "jaw")) == [0.25, 0.25, 0.5]
    assert torch.equal(driven.translation, moved.translation)
    for name in ("root", "neck", "left_eye", "right_eye"):
        assert torch.equal(pose_of(driven, name), pose_of(moved, name)), name


def test_the_neutral_frame_itself_has_the_avatars_neutral_face():
    neutral = frame(root=(0.1, 0.2, 0.3), jaw=(0.05, 0.01, 0), expression=(0.3, -0.2, 0.1, 1.7))
    driven = own(neutral=neutral, gain=3.0).drive(neutral)
    assert numbers(driven.expression) == [0.0] * 4
    assert numbers(pose_of(driven, "jaw")) == [0.0] * 3
    assert torch.equal(pose_of(driven, "root"), pose_of(neutral, "root"))


def test_a_frames_offset_is_a_movement():
    """Who calls decides whether the heads are near enough for it."""
    offset = torch.ones(5, 3)
    assert own().drive(replace(frame(), dynamic_offset=offset)).dynamic_offset is offset


def test_a_batch_is_driven_as_its_frames():
    frames = [frame(jaw=(0.1 * row, 0, 0), expression=(row, 1, 2, 3), root=(0, row, 0)) for row in range(3)]
    driver = own(neutral=frames[1], gain=0.5, seen=PoseRange.of(frames[:2]))
    together = driver.drive(FrameParameters.stack(frames))
    assert all(same(together[row], driver.drive(alone)) for row, alone in enumerate(frames))


def test_a_pose_is_held_to_each_numbers_own_range():
    seen = PoseRange.of(
        [
            frame(translation=(5, 5, 5), root=(-0.5, 0, 0), jaw=(0, 0, 0), right_eye=(0, 0, -1)),
            frame(root=(0.25, 0.75, 0), jaw=(0.5, 0, 0), right_eye=(0, 0, 1)),
            frame(root=(0, 0.5, 0), neck=(0, 0, 0.125), expression=(9, 9, 9, 9)),
        ]
    )
    driven = frame(
        translation=(7, 7, 7),
        root=(-1, 0.5, 0.1),
        neck=(0.1, -0.1, 0.5),
        jaw=(0.75, -1, 0),
        left_eye=(1, 2, 3),
        right_eye=(4, 5, -6),
        expression=(8, 8, 8, 8),
    )
    held = own(seen=seen).drive(driven)
    assert numbers(held.rotations) == [
        [-0.5, 0.5, 0.0],
        [0.0, 0.0, 0.125],
        [0.5, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
    ]
    # where the head is and what it says are no pose
    assert torch.equal(held.translation, driven.translation)
    assert torch.equal(held.expression, driven.expression)


def test_the_jaw_is_held_after_it_was_made_relative():
    seen = PoseRange.of([frame(), frame(jaw=(0.5, 0, 0))])
    driver = own(neutral=frame(jaw=(0.25, 0, 0)), seen=seen)
    assert numbers(pose_of(driver.drive(frame(jaw=(0.625, 0, 0))), "jaw")) == [0.375, 0.0, 0.0]
    assert numbers(pose_of(driver.drive(frame(jaw=(0.0, 0, 0))), "jaw")) == [0.0, 0.0, 0.0]


def test_poses_that_were_seen_are_left_alone():
    frames = [frame(root=(0.1 * number, -0.2, 0.3), jaw=(0.01 * number, 0, 0)) for number in range(4)]
    seen = PoseRange.of(frames)
    assert all(same(seen.hold(one), one) for one in frames)


def test_equal_templates_match_whatever_their_names_are():
    matched = match_expressions(small_template(), replace(small_template()), source="other")
    assert numbers(matched.source) == numbers(matched.target) == list(range(4))
    assert matched.left_out == ()


def test_expressions_are_matched_by_name():
    driver, avatar = (
        named("smileRight", "jawOpen", "puff", "browsUp", "smileLeft"),
        named("tongueOut", *NAMES),
    )
    matched = match_expressions(driver, avatar, source="other")  # four of five: exactly 80 %
    assert matched.left_out == ("puff",)
    carried = matched.carry(torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]))
    assert numbers(carried) == [0.0, 2.0, 4.0, 5.0, 1.0]


def test_neutral_and_gain_are_the_drivers_before_names_are_matched():
    driver = named("b", "a")
    matched = match_expressions(driver, named("a", "new", "b"), source="other")
    neutral = replace(frame(), expression=torch.tensor([1.0, -1.0]))
    driven = Driver(driver, matched, NameMap.identity(5), neutral=neutral, gain=0.5).drive(
        replace(frame(), expression=torch.tensor([3.0, 3.0]))
    )
    assert numbers(driven.expression) == [2.0, 0.0, 1.0]


def test_too_few_names_in_common_are_refused():
    driver, avatar = named(*NAMES, "puff", "sneer"), named(*NAMES)
    with pytest.raises(UserError, match=r"^other.npz: .*80%.*shares the names of 4 of its 6 expressions$"):
        match_expressions(driver, avatar, source="other.npz")


@pytest.mark.parametrize(
    "names",
    [
        ("expression_000", "expression_001"),
        ("expr_000", "expr_001"),
        ("Expression0", "Expression1"),
        ("exp.1", "exp.2"),
        ("0", "1"),
        ("", " "),
        ("blend_shape-1", "BlendShape2"),
    ],
)
def test_numbers_are_no_names(names):
    driver, avatar = named(*names), named(*names, "jawOpen")
    with pytest.raises(UserError, match="its expressions have numbers for names"):
        match_expressions(driver, avatar, source="other")
    with pytest.raises(UserError, match="the avatar's expressions have numbers for names"):
        match_expressions(named("jawOpen", "browsUp"), named(*names), source="other")


@pytest.mark.parametrize("name", ["jawOpen", "AU12", "expression_smile", "eyelid_left", "smile_01", "口"])
def test_names_that_say_something_are_names(name):
    assert match_expressions(named(name), named("other", name), source="other").target.tolist() == [1]


def test_a_name_that_two_expressions_have_is_neithers():
    driver, avatar = named("a", "a", "b", "c", "d", "e"), named("a", "b", "c", "d", "e")
    with pytest.raises(UserError, match="4 of its 6"):
        match_expressions(driver, avatar, source="other")
    driver = named("a", "b", "c", "d", "e")
    matched = match_expressions(driver, named("a", "a", "b", "c", "d", "e"), source="other")
    assert matched.left_out == ("a",)
    assert matched.target.tolist() == [2, 3, 4, 5]


def test_other_vertices_with_the_same_names_are_welcome():
    template = named(*NAMES)
    taller = replace(template, v_template=1.1 * template.v_template)
    assert match_expressions(taller, template, source="other").left_out == ()


@pytest.fixture(scope="module")
def seven(tmp_path_factory):
    """A head of seven joints, the root of another name."""
    path = tmp_path_factory.mktemp("rigs") / "seven.npz"
    np.savez(path, **with_seven_joints(tiny_template()))
    return read_template(path)


def test_joints_are_matched_by_name_and_roots_by_being_roots(seven):
    matched = match_joints(small_template(), seven)
    carried = matched.carry(torch.arange(5.0)[:, None] + 1.0, dim=-2)[:, 0]
    # base, neck, head, jaw, left_eye, right_eye, tongue
    assert numbers(carried) == [1.0, 2.0, 0.0, 3.0, 4.0, 5.0, 0.0]
    assert matched.left_out == ()
    back = match_joints(seven, small_template())
    assert numbers(back.carry(torch.arange(7.0))) == [0.0, 1.0, 3.0, 4.0, 5.0]
    assert back.left_out == ("head", "tongue")
    assert numbers(match_joints(seven, seven).source) == list(range(7))


def test_another_rig_drives_by_name(seven):
    driver = Driver(
        seven,
        match_expressions(seven, seven, source="other"),
        match_joints(seven, small_template()),
        neutral=frame(joints=SEVEN, jaw=(0.25, 0, 0), head=(9, 9, 9), tongue=(9, 9, 9)),
        seen=PoseRange.of([frame(root=(-9, -9, -9)), frame(root=(9, 9, 9), jaw=(0.5, 0, 0))]),
    )
    driven = driver.drive(
        frame(joints=SEVEN, base=(1, 2, 3), jaw=(0.5, 0.5, 0), left_eye=(1, 1, 1), tongue=(4, 4, 4))
    )
    # the jaw relative to the neutral one, then held to what was seen as the others are
    assert numbers(driven.rotations) == [[1, 2, 3], [0] * 3, [0.25, 0, 0], [0] * 3, [0] * 3]


def test_a_driver_without_a_jaw_has_nothing_to_take_from(tmp_path):
    np.savez(tmp_path / "jawless.npz", **without_a_jaw(tiny_template()))
    jawless = read_template(tmp_path / "jawless.npz")
    joints = jawless.joint_names
    driver = Driver(
        jawless,
        NameMap.identity(4),
        match_joints(jawless, small_template()),
        neutral=frame(joints=joints, neck=(9, 9, 9), expression=(1, 0, 0, 0)),
    )
    driven = driver.drive(frame(joints=joints, neck=(1, 0, 0), right_eye=(0, 1, 0)))
    assert numbers(pose_of(driven, "neck")) == [1.0, 0.0, 0.0]
    assert numbers(pose_of(driven, "jaw")) == [0.0] * 3
    assert numbers(pose_of(driven, "right_eye")) == [0.0, 1.0, 0.0]
