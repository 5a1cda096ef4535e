"""Avatars on heads of other joints than FLAME's, from a dataset to a picture."""

from dataclasses import replace

import numpy as np
import pytest
from data.damage import change_arrays
from data.rigs import OTHERS, SEVEN, with_seven_joints
from data.tiny import make_tiny_dataset, tiny_template
from subjects import render_command, train_arguments, train_command

from samira_warp.avatar import Avatar, read_frames


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """The made-up subject on seven joints; its head nods and its tongue moves."""
    root = make_tiny_dataset(tmp_path_factory.mktemp("seven") / "subject")
    np.savez(root / "template.npz", **with_seven_joints(tiny_template()))
    for row, path in enumerate([root / "canonical_flame_param.npz", *sorted(root.glob("flame_param/*.npz"))]):
        poses = {f"pose_{name}": np.full((1, 3), 0.02 * row, np.float32) for name in OTHERS}
        change_arrays(path, **poses)
    return root


@pytest.fixture(scope="module")
def trained(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("seven run") / "run"
    assert train_command(*train_arguments(dataset, out)) == 0
    return out


def test_the_avatar_has_the_templates_joints(trained):
    avatar = Avatar.load(trained)
    assert avatar.canonical.rig.joint_names == SEVEN
    assert avatar.statistics.pose_mean.shape == (21,)
    frames = read_frames(trained)
    assert all(frame.parameters.rotations.shape == (7, 3) for frame in frames)


def test_every_joint_moves_and_learns(trained):
    avatar, frame = Avatar.load(trained), read_frames(trained)[0]
    rotations = frame.parameters.rotations.clone().requires_grad_()
    moved = avatar.move(replace(frame.parameters, rotations=rotations))
    moved.gaussians.means.square().sum().backward()
    assert (rotations.grad.norm(dim=1) > 0).all()


def test_it_renders_its_dataset_as_its_own_frames(trained, dataset, tmp_path):
    assert render_command("--avatar", trained, "--out", tmp_path / "own") == 0
    assert render_command("--avatar", trained, "--out", tmp_path / "data", "--data", dataset) == 0
    own, data = (
        {path.name: path.read_bytes() for path in (tmp_path / name / "image").iterdir()}
        for name in ("own", "data")
    )
    assert own == data
