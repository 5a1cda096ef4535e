"""Datasets whose template has other joints than FLAME's: tracked poses find theirs by name."""

import numpy as np
import pytest
import torch
from data.damage import change_arrays
from data.layouts import WRITERS, joint_rotations, make_film_for, write_layout
from data.rigs import OTHERS, SEVEN, with_seven_joints, without_a_jaw
from data.tiny import tiny_template

from samira_warp.data import open_listing, open_sequence
from samira_warp.support.errors import UserError
from samira_warp.support.faults import collected_faults

NPZ_LAYOUTS = ("VHAP export", "VHAP tracked")


def write(layout, root, template, film=None):
    film = film or make_film_for(layout)
    write_layout(layout, film, root)
    np.savez(root / "template.npz", **template)
    return film


def pose_others(layout, root, film, **changes):
    """Write poses of the joints that FLAME does not have: (T, 3) by name."""
    poses = {name: 0.1 * np.random.default_rng(7).normal(size=(len(film), 3)) for name in OTHERS} | changes
    for name, pose in poses.items():
        if layout == "VHAP tracked":
            change_arrays(root / "tracked_flame_params_30.npz", **{f"pose_{name}": pose.astype(np.float32)})
            continue
        for row, frame in enumerate(film.names):
            change = {f"pose_{name}": pose[row : row + 1].astype(np.float32)}
            change_arrays(root / "flame_param" / f"{frame}.npz", **change)
        change_arrays(root / "canonical_flame_param.npz", **{f"pose_{name}": np.zeros((1, 3), np.float32)})
    return poses


@pytest.mark.parametrize("layout", NPZ_LAYOUTS)
def test_each_joint_gets_the_pose_of_its_name(tmp_path, layout):
    root = tmp_path / "subject"
    film = write(layout, root, with_seven_joints(tiny_template()))
    poses = pose_others(layout, root, film)
    sequence = open_sequence(root)
    assert sequence.template.joint_names == SEVEN
    assert sequence.template.head_joint == "head"
    for row, frame in enumerate(sequence.frames):
        flame = joint_rotations(film, row)
        expected = [flame[0], flame[1], poses["head"][row], *flame[2:], poses["tongue"][row]]
        # float32 of numbers below 2
        np.testing.assert_allclose(frame.parameters.rotations.numpy(), expected, atol=2e-7)


@pytest.mark.parametrize("layout", NPZ_LAYOUTS)
@pytest.mark.parametrize("name", OTHERS)
def test_a_joint_without_a_pose_is_named(tmp_path, layout, name):
    root = tmp_path / "subject"
    film = write(layout, root, with_seven_joints(tiny_template()))
    pose_others(layout, root, film)
    path = root / ("tracked_flame_params_30.npz" if layout == "VHAP tracked" else "flame_param/00002.npz")
    change_arrays(path, **{f"pose_{name}": None})
    with pytest.raises(UserError, match=rf"{path.name}: expected the key pose_{name}, found only"):
        open_sequence(root)
    assert len(open_listing(root).frames) == len(film)  # which does not ask for heads


@pytest.mark.parametrize("layout", NPZ_LAYOUTS)
def test_a_pose_of_another_shape_is_named(tmp_path, layout):
    root = tmp_path / "subject"
    film = write(layout, root, with_seven_joints(tiny_template()))
    pose_others(layout, root, film, tongue=np.zeros((len(film), 4)))
    with pytest.raises(UserError, match=r"pose_tongue: expected numbers of shape"):
        open_sequence(root)


def test_all_that_is_missing_is_said_at_once(tmp_path):
    root = tmp_path / "subject"
    write("VHAP export", root, with_seven_joints(tiny_template()))
    with collected_faults() as faults:
        open_sequence(root)
    first = [fault.expected for fault in faults][:2]
    assert first == [f"the key pose_{name}" for name in OTHERS]


@pytest.mark.parametrize("layout", [name for name in WRITERS if name not in NPZ_LAYOUTS])
def test_trackers_of_flame_alone_cannot_pose_other_joints(tmp_path, layout):
    root = tmp_path / "subject"
    arrays = with_seven_joints(tiny_template())
    write(layout, root, arrays)
    with pytest.raises(UserError, match=r": head: expected a pose of each joint of the head template"):
        open_sequence(root)


@pytest.mark.parametrize("layout", WRITERS)
def test_a_jaw_that_opens_needs_a_joint(tmp_path, layout):
    """Without the joint the head would be another one than was tracked."""
    write(layout, tmp_path / "subject", without_a_jaw(tiny_template()))
    wanted = r": jaw: expected no rotation of it, for the head template has no such joint, found up to 0\.\d+"
    with pytest.raises(UserError, match=wanted):
        open_sequence(tmp_path / "subject")


@pytest.mark.parametrize("layout", WRITERS)
def test_a_jaw_that_stays_shut_needs_none(tmp_path, layout):
    film = make_film_for(layout)
    film.jaw[:] = 0.0
    root = tmp_path / "subject"
    write(layout, root, without_a_jaw(tiny_template()), film)
    if layout == "VHAP export":  # nor does a file of such a template have to speak of it
        change_arrays(root / "flame_param" / "00001.npz", jaw_pose=None)
    frames = open_sequence(root).frames
    assert all(frame.parameters.rotations.shape == (4, 3) for frame in frames)
    if layout in NPZ_LAYOUTS:
        expected = joint_rotations(film, 1)[[0, 1, 3, 4]]
        np.testing.assert_allclose(frames[1].parameters.rotations.numpy(), expected, atol=1e-7)


def test_a_camera_is_held_whatever_the_root_is_called(tmp_path):
    """The head's own motion goes to the first joint."""
    frames = []
    for name in ("root", "base"):
        root = tmp_path / name
        names = np.array([name, "neck", "jaw", "left_eye", "right_eye"])
        film = make_film_for("metrical-tracker")
        film.eyelids[:] = 0.0
        write("metrical-tracker", root, tiny_template() | {"joint_names": names}, film)
        frames.append([frame.parameters for frame in open_sequence(root).frames])
    for first, second in zip(*frames, strict=True):
        assert first.rotations[0].any() or first is frames[0][0]
        assert torch.equal(first.rotations, second.rotations)
        assert torch.equal(first.translation, second.translation)


def test_numbers_of_flames_joints_alone_are_read_as_before(tmp_path):
    """A key pose_jaw beside jaw_pose has no meaning."""
    root = tmp_path / "subject"
    write("VHAP export", root, tiny_template())
    plain = open_sequence(root).frames[0].parameters
    for path in [*root.glob("flame_param/*.npz"), root / "canonical_flame_param.npz"]:
        change_arrays(path, pose_jaw=np.ones((1, 3), np.float32))
    assert torch.equal(open_sequence(root).frames[0].parameters.rotations, plain.rotations)
