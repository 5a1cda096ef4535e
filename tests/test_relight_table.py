import functools
import importlib.util
import json
import shutil
import sys

import numpy as np
import pytest
from subjects import TESTS

from samira_warp.io.images import read_image, write_exr, write_png
from samira_warp.light import Environment

TOOL = TESTS.parent / "tools" / "relight_table.py"


@pytest.fixture
def tool(monkeypatch):
    """The tool's module, with environment maps as cubes of 32 texels: the default's 256 take seconds to
    filter."""
    spec = importlib.util.spec_from_file_location("relight_table", TOOL)
    module = importlib.util.module_from_spec(spec)
    sys.modules["relight_table"] = module
    spec.loader.exec_module(module)
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=32))
    return module


def with_truth(tiny_dataset, folder):
    """A dataset with one light, under which everything is white: truth is what an oracle of white albedo
    gives."""
    data = shutil.copytree(tiny_dataset, folder)
    names = ("00004_00", "00005_00")
    for layer in ("relight/even", "normal", "albedo"):
        (data / "gt" / layer).mkdir(parents=True)
    (data / "lights").mkdir()
    write_exr(data / "lights" / "even.exr", np.ones((8, 16, 3)))
    description = {"file": "lights/even.exr", "azimuth_degrees": 0.0, "exposure": 1.0}
    (data / "gt" / "relight" / "even.json").write_text(json.dumps(description))
    (data / "gt" / "capture_light.json").write_text(json.dumps(description))
    for name in names:
        mask = read_image(data / "fg_masks" / f"{name}.png", channels=1)
        normal = np.broadcast_to([0.5, 0.5, 1.0], (32, 32, 3))
        write_png(data / "gt" / "normal" / f"{name}.png", normal)
        write_png(data / "gt" / "albedo" / f"{name}.png", np.ones((32, 32, 3)))
        write_png(data / "gt" / "relight" / "even" / f"{name}.png", np.ones((32, 32, 3)) * mask + 1 - mask)
    return data


def test_a_row_for_each_light_with_the_oracle_beside_it(tiny_run, tiny_dataset, tool, tmp_path, capsys):
    data = with_truth(tiny_dataset, tmp_path / "data")
    arguments = ["--avatar", str(tiny_run), "--data", str(data), "--resolution", "32", "--json"]
    capsys.readouterr()
    assert tool.run(tool.main, tool.TableConfig, program="relight_table", arguments=arguments) == 0
    rows = {row["light"]: row for row in json.loads(capsys.readouterr().out)}
    assert "even" in rows
    # a white furnace: albedo 1 under light of 1 reflects all but what the split sum loses, some per cent
    assert rows["even"]["oracle foreground"] > 30
    assert rows["even"]["avatar foreground"] < rows["even"]["oracle foreground"]
    for row in rows.values():
        assert {
            f"{who} {score}" for who in ("avatar", "oracle") for score in ("PSNR", "foreground", "with gain")
        } < set(row)


def test_an_avatar_that_is_given_all_of_the_truth_is_the_oracle(
    tiny_run, tiny_dataset, tool, tmp_path, capsys, monkeypatch
):
    data = with_truth(tiny_dataset, tmp_path / "data")
    arguments = ["--avatar", str(tiny_run), "--data", str(data), "--resolution", "32", "--json"]
    capsys.readouterr()
    assert tool.run(tool.main, tool.TableConfig, program="relight_table", arguments=arguments) == 0
    (even, _) = json.loads(capsys.readouterr().out)
    monkeypatch.syspath_prepend(str(TOOL.parent))
    swap = importlib.import_module("swap_channels")
    arguments += ["--every", "1"]
    assert tool.run(swap.main, swap.SwapConfig, program="swap_channels", arguments=arguments) == 0
    rows = {row["given"]: row["even"] for row in json.loads(capsys.readouterr().out)}
    assert list(rows) == list(swap.ROWS)
    # the same arithmetic on float32, rounded to bytes
    assert rows["as learned"] == pytest.approx(even["avatar PSNR"], abs=0.01)
    assert rows["all of it"] == pytest.approx(even["oracle in shadow PSNR"], abs=0.01)
    assert rows["as learned"] < rows["all of it"]


def test_a_dataset_without_lights_is_named(tiny_run, tiny_dataset, tool, capsys):
    arguments = ["--avatar", str(tiny_run), "--data", str(tiny_dataset)]
    capsys.readouterr()
    assert tool.run(tool.main, tool.TableConfig, program="relight_table", arguments=arguments) == 2
    assert str(tiny_dataset / "gt" / "relight") in capsys.readouterr().err
