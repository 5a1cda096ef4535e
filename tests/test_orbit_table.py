"""The table of an avatar seen from all around."""

import importlib
import json
import shutil

import pytest
import torch
from subjects import TESTS, render_command

from samira_warp.evaluate.__main__ import command as evaluate_command


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    return importlib.import_module("orbit_table")


def test_rows_are_the_scores_of_the_verbs(tiny_run, tiny_dataset, stand_in_dataset, tool, tmp_path, capsys):
    data = shutil.copytree(stand_in_dataset, tmp_path / "data")
    orbit = data / "gt" / "orbit"
    # the same sphere, but its expressions have no names
    shutil.copyfile(tiny_dataset / "template.npz", orbit / "template.npz")
    arguments = ["--avatar", str(tiny_run), "--data", str(data), "--resolution", "32", "--json"]
    capsys.readouterr()
    assert tool.run(tool.main, tool.OrbitConfig, program="orbit_table", arguments=arguments) == 0
    rows = {row.pop("view"): row for row in json.loads(capsys.readouterr().out)}
    # two poses from three sides, but for the one that training saw
    assert {view: row["pictures"] for view, row in rows.items()} == {
        "yaw 0": "1",
        "yaw 90": "2",
        "pitch 40": "2",
        "all": "5",
    }
    drive = ("--data", orbit, "--no-clamp")
    assert render_command("--avatar", tiny_run, *drive, "--out", tmp_path / "out") == 0
    capsys.readouterr()
    assert evaluate_command(["--pred", str(tmp_path / "out"), "--data", str(orbit)]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert len(scores["frames"]) == 5
    # float32 sums in another order, at most
    assert rows["all"]["PSNR"] == pytest.approx(scores["psnr"], abs=1e-3)
    assert rows["all"]["foreground"] == pytest.approx(scores["psnr_foreground"], abs=1e-3)
    assert rows["yaw 0"]["PSNR"] == pytest.approx(
        scores["frames"]["expression_yaw+000_pitch+00"]["psnr"], abs=1e-3
    )


def test_opacity_counts_where_the_outline_is_a_pixel_away(tool):
    mask = torch.zeros(20, 20)
    mask[5:15, 5:15] = 1.0
    assert tool.misplaced(mask, mask) == {"outside, %": 0.0, "lacking inside, %": 0.0}
    # all but the square and a pixel about it, and the square without its outermost pixels
    found = tool.misplaced(torch.full((20, 20), 0.25), mask)
    assert found["outside, %"] == pytest.approx(100 * 0.25 * (400 - 12 * 12) / 400)
    assert found["lacking inside, %"] == pytest.approx(100 * 0.75 * 8 * 8 / 400)


def test_a_dataset_without_an_orbit_is_named(tiny_run, tiny_dataset, tool, capsys):
    arguments = ["--avatar", str(tiny_run), "--data", str(tiny_dataset)]
    capsys.readouterr()
    assert tool.run(tool.main, tool.OrbitConfig, program="orbit_table", arguments=arguments) == 2
    assert str(tiny_dataset / "gt" / "orbit") in capsys.readouterr().err
