"""A copy of a dataset whose template has fewer expressions."""

import importlib
import re
import shutil

import numpy as np
import pytest
import torch
from data.damage import change_arrays
from data.layouts import make_film_for, write_layout
from data.tiny import N_EXPRESSION
from subjects import TESTS

from samira_warp.data import open_sequence
from samira_warp.head import Rig


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    return importlib.import_module("coarse_template")


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    """The tiny subject, whose own expressions are two of them, with expressions of full rank."""
    folder = shutil.copytree(tiny_dataset, tmp_path / "subject")
    rng = np.random.default_rng(0)
    for path in sorted((folder / "flame_param").iterdir()):
        values = rng.normal(size=(1, N_EXPRESSION)).astype(np.float32)
        change_arrays(path, expr=lambda _, values=values: values)
    return folder


def coarse(tool, data, out, count):
    arguments = ["--data", str(data), "--out", str(out), "--directions", str(count)]
    return tool.run(tool.main, tool.CoarseConfig, program="coarse_template", arguments=arguments)


def posed(folder):
    """(N, V, 3) vertices of all frames in the world."""
    sequence = open_sequence(folder)
    rig = Rig.build(sequence.template)
    heads = [
        rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
        for frame in sequence.frames
    ]
    return torch.stack(heads).numpy()


def displacements(folder, part):
    """(N, 3 V) float64 metres by which expressions move the vertices of some frames."""
    sequence = open_sequence(folder)
    shapes = sequence.template.shapedirs[:, :, sequence.template.n_shape :].astype(np.float64)
    coefficients = sequence.batch(getattr(sequence, part)).expression.numpy().astype(np.float64)
    return coefficients @ shapes.reshape(-1, shapes.shape[2]).T


@pytest.mark.parametrize("rank", [2, 4])
def test_as_many_directions_as_there_are_pose_the_same_head(tool, tiny_dataset, dataset, tmp_path, rank):
    data = dataset if rank == 4 else tiny_dataset
    assert coarse(tool, data, tmp_path / "copy", rank) == 0
    copy = open_sequence(tmp_path / "copy")
    assert copy.template.n_expression == rank
    # a vertex is a sum of half a dozen products of up to 0.1 m, each rounded to 6e-8 of itself
    np.testing.assert_allclose(posed(tmp_path / "copy"), posed(data), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_leave_what_the_singular_values_say(tool, dataset, tmp_path, count):
    """Eckart and Young: no other so many directions leave less of the training frames."""
    assert coarse(tool, dataset, tmp_path / "copy", count) == 0
    before, after = (displacements(folder, "train") for folder in (dataset, tmp_path / "copy"))
    singular = np.linalg.svd(before, compute_uv=False)
    left = np.square(before - after).sum()
    # written as float32: 6e-8 of displacements whose squares' sum is that of all singular values
    assert left == pytest.approx(np.square(singular[count:]).sum(), rel=1e-5)
    copy = open_sequence(tmp_path / "copy")
    coefficients = copy.batch(copy.train).expression.numpy()
    np.testing.assert_allclose(np.square(coefficients).mean(axis=0), 1.0, rtol=1e-5)
    # test frames are projected on the training frames' directions: what is left is at right angles to them
    rest, kept = (displacements(folder, "test") for folder in (dataset, tmp_path / "copy"))
    basis = np.linalg.svd(before, full_matrices=False)[2][:count]
    np.testing.assert_allclose(kept, rest @ basis.T @ basis, rtol=0.0, atol=1e-8)


def test_what_is_missing_is_said_in_millimetres(tool, dataset, tmp_path, capsys):
    capsys.readouterr()
    assert coarse(tool, dataset, tmp_path / "copy", 2) == 0
    said = re.findall(r"([\d.]+) mm", capsys.readouterr().out)
    left = np.concatenate(
        [displacements(dataset, part) - displacements(tmp_path / "copy", part) for part in ("train", "test")]
    )
    lengths = 1e3 * np.linalg.norm(left.reshape(len(left), -1, 3), axis=2)
    expected = [lengths.mean(), np.percentile(lengths, 99), lengths.max()]
    np.testing.assert_allclose(np.array(said, float), expected, atol=6e-4)


def test_all_else_is_linked(tool, dataset, tmp_path):
    assert coarse(tool, dataset, tmp_path / "copy", 2) == 0
    own = {"template.npz", "flame_param", "canonical_flame_param.npz"}
    entries = {path.name: path for path in (tmp_path / "copy").iterdir()}
    assert entries.keys() == {path.name for path in dataset.iterdir()}
    assert {name for name, path in entries.items() if not path.is_symlink()} == own
    before, after = open_sequence(dataset), open_sequence(tmp_path / "copy")
    for ours, theirs in zip(after.frames, before.frames, strict=True):
        assert torch.equal(ours.parameters.rotations, theirs.parameters.rotations)
    for name in ("v_template", "weights", "faces", "vt"):
        np.testing.assert_array_equal(getattr(after.template, name), getattr(before.template, name))
    identity = before.template.shapedirs[:, :, : before.template.n_shape]
    np.testing.assert_array_equal(after.template.shapedirs[:, :, : after.template.n_shape], identity)


@pytest.mark.parametrize("count", [-1, 0, 3])
def test_directions_that_are_not_there(tool, tiny_dataset, tmp_path, capsys, count):
    capsys.readouterr()
    assert coarse(tool, tiny_dataset, tmp_path / "copy", count) == 2
    assert "--directions: expected a number from 1 to 2, which is how many" in capsys.readouterr().err
    assert not (tmp_path / "copy").exists()


def test_a_folder_that_is_there_is_left_alone(tool, tiny_dataset, tmp_path, capsys):
    assert coarse(tool, tiny_dataset, tmp_path, 1) == 2
    assert f"{tmp_path}: expected a new folder" in capsys.readouterr().err


def test_another_layout_is_named(tool, tiny_dataset, tmp_path, capsys):
    data = write_layout("IMavatar", make_film_for("IMavatar"), tmp_path / "data")
    shutil.copy(tiny_dataset / "template.npz", data / "template.npz")
    assert coarse(tool, data, tmp_path / "copy", 1) == 2
    assert "expected a VHAP export, found IMavatar's flame_params.json" in capsys.readouterr().err
