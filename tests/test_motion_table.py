"""What is said of a residual's motion beside the true one."""

import importlib
import json
import shutil

import numpy as np
import pytest
import torch
from subjects import TESTS

from samira_subject.hidden_motion import hidden_motion
from samira_warp.avatar import Avatar
from samira_warp.data import open_sequence
from samira_warp.head import Rig


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    return importlib.import_module("motion_table")


@pytest.fixture
def data(built_in_datasets, tmp_path):
    """The built-in subject's film with what hidden motion would have been."""
    data = shutil.copytree(built_in_datasets["VHAP export"], tmp_path / "data")
    sequence = open_sequence(data)
    hidden, rig = hidden_motion(sequence.template), Rig.build(sequence.template)
    frames = sorted(sequence.frames, key=lambda frame: frame.timestep)
    moved = [hidden.in_world(f.parameters, rig.pose(f.parameters, sequence.shape)).numpy() for f in frames]
    (data / "gt").mkdir(exist_ok=True)
    np.savez(data / "gt" / "hidden_motion.npz", displacement=np.stack(moved))
    return data


def test_shares_of_a_motion_have_their_closed_form(tool, generator):
    truth = 1e-3 * torch.randn(500, 3, generator=generator)
    found = tool.agreement(truth, truth)
    assert (found["recovered, %"], found["error, mm"]) == (100.0, 0.0)
    assert found["correlation"] == pytest.approx(1.0, abs=1e-5)
    # half of it leaves half of it: a quarter of the energy
    half = tool.agreement(truth, 0.5 * truth)
    assert half["recovered, %"] == pytest.approx(75.0, abs=1e-3)
    assert half["followed, %"] == pytest.approx(50.0, abs=1e-3)
    assert half["residual, mm"] == pytest.approx(0.5 * half["true, mm"])
    nothing = tool.agreement(truth, torch.zeros_like(truth))
    assert (nothing["recovered, %"], nothing["correlation"]) == (0.0, 0.0)
    upward = tool.agreement(truth, truth * torch.tensor([0.0, 1.0, 0.0]))
    assert (upward["sideways, %"], upward["upward, %"]) == (0.0, 100.0)
    flat = tool.agreement(truth * torch.tensor([0.0, 1.0, 1.0]), truth)
    assert (flat["sideways, %"], flat["upward, %"]) == ("none", 100.0)
    wrong = tool.agreement(truth, -truth)
    assert wrong["followed, %"] == pytest.approx(-100.0, abs=1e-3)
    assert wrong["recovered, %"] == pytest.approx(-300.0, abs=1e-3)


def test_rows_of_an_avatar_that_was_not_shown_any(tool, built_in_run, data, capsys):
    arguments = ["--avatar", str(built_in_run), "--data", str(data), "--resolution", "64", "--json"]
    capsys.readouterr()
    assert tool.run(tool.main, tool.MotionTableConfig, program="motion_table", arguments=arguments) == 0
    rows = {row["region"]: row for row in json.loads(capsys.readouterr().out)}
    assert {"scalp", "neck", "all"} <= set(rows)
    # hair lags by up to 8 mm, and six steps have learned nothing of it
    assert 1.0 < rows["scalp"]["true, mm"] < 11.0
    assert abs(rows["all"]["recovered, %"]) < 10.0
    assert 10.0 < rows["all"]["moving pixels, dB"] < 40.0


def test_training_frames_are_compared_when_they_are_asked_for(tool, built_in_run, data, capsys):
    told = []
    for split in ("test", "train"):
        arguments = ["--avatar", str(built_in_run), "--data", str(data), "--resolution", "64", "--json"]
        capsys.readouterr()
        status = tool.run(
            tool.main,
            tool.MotionTableConfig,
            program="motion_table",
            arguments=[*arguments, "--split", split],
        )
        assert status == 0
        told.append({row["region"]: row["true, mm"] for row in json.loads(capsys.readouterr().out)})
    assert told[0]["all"] != told[1]["all"]


def test_a_residual_that_is_the_truth_recovers_all_in_either_axes(tool, built_in_run, data):
    """Tracks of the truth, turned as an avatar's residual would be."""
    sequence, hidden = open_sequence(data), tool.read_hidden(data)
    avatar = Avatar.load(built_in_run)
    with torch.no_grad():
        train = tool.tracks(avatar, sequence, sequence.train, hidden)
        test = tool.tracks(avatar, sequence, sequence.test, hidden)
    exact = [part._replace(residual=part.truth + 0.01) for part in (train, test)]
    rows = {row["region"]: row for row in tool.region_rows(avatar, *exact)}
    # a constant is where Gaussians rest, and none of the motion
    assert rows["all"]["recovered, %"] == pytest.approx(100.0, abs=0.1)


def test_a_dataset_without_the_truth_is_named(tool, built_in_run, built_in_datasets, capsys):
    root = built_in_datasets["VHAP export"]
    arguments = ["--avatar", str(built_in_run), "--data", str(root)]
    assert tool.run(tool.main, tool.MotionTableConfig, program="motion_table", arguments=arguments) == 2
    assert str(root / "gt" / "hidden_motion.npz") in capsys.readouterr().err


def test_capacity_is_learned_from_the_truth_itself(monkeypatch, data, capsys):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    tool = importlib.import_module("motion_capacity")
    arguments = ["--data", str(data), "--steps", "30", "--json"]
    capsys.readouterr()
    assert tool.run(tool.main, tool.CapacityConfig, program="motion_capacity", arguments=arguments) == 0
    rows = {row["region"]: row for row in json.loads(capsys.readouterr().out)}
    # five frames' motion, of which three others show a good part
    assert rows["all"]["correlation"] > 0.3
