import importlib.util
import sys

import pytest
import torch
from subjects import TESTS

from samira_warp.bench import raster
from samira_warp.io.images import read_image
from samira_warp.support.constants import ALPHA_MIN


@pytest.fixture
def tool():
    spec = importlib.util.spec_from_file_location(
        "raster_growth", TESTS.parent / "tools" / "raster_growth.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["raster_growth"] = module
    spec.loader.exec_module(module)
    return module


def test_without_matplotlib_one_line_says_what_to_install(tool, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(tool.importlib.util, "find_spec", lambda name: None)
    arguments = ["--out", str(tmp_path / "growth.png"), "--device", "cpu"]
    assert tool.run(tool.main, tool.GrowthConfig, program="raster_growth", arguments=arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""  # nothing was measured first
    (line,) = said.err.strip().splitlines()
    assert "matplotlib" in line
    assert "pip install" in line


def test_table_and_plot(tool, monkeypatch, tmp_path, capsys):
    small = {
        "gaussians": [tool.Point(100, 0, 32, 3), tool.Point(200, 0, 32, 3)],
        "size": [tool.Point(100, 0, 32, 3), tool.Point(100, 0, 64, 3)],
        "channels": [tool.Point(100, 0, 32, 1), tool.Point(100, 0, 32, 2)],
        "culled": [tool.Point(100, 0, 32, 3), tool.Point(100, 100, 32, 3)],
    }
    monkeypatch.setattr(tool, "SWEEPS", small)
    tool.main(tool.GrowthConfig(out=tmp_path / "growth.png", device="cpu"))
    lines = capsys.readouterr().out.splitlines()
    header, rule, *rows = (line.split("|") for line in lines if line.startswith("|"))
    assert len(rows) == 8
    assert {len(cells) for cells in (header, rule, *rows)} == {len(header)}
    intersections = [int(cells[6]) for cells in rows]
    assert intersections[1] > 1.5 * intersections[0]
    # half of 200 cannot be seen: as many intersections as 100 have, give or take their sizes
    assert intersections[7] < 0.7 * intersections[1]
    assert read_image(tmp_path / "growth.png", channels=3).shape == (900, 1200, 3)


def test_culled_gaussians_are_behind_beside_and_too_faint(tool):
    scene = tool._disc(tool.Point(100, 60, 64, 3), torch.device("cpu"))
    behind = scene.means[:, 2] < 0
    faint = scene.opacities < ALPHA_MIN
    # the image is 1 / 50 of the distance wide
    beside = (scene.means[:, 0] / scene.means[:, 2].abs()).abs() > 0.5 / 50
    assert [int(kind.sum()) for kind in (behind, beside, faint)] == [20, 20, 20]
    culled = behind | beside | faint
    assert culled.sum() == 60
    bins = raster._prepare(scene)[1]
    assert not culled[bins.gaussians.long()].any()


@pytest.mark.parametrize(
    ("out", "named"), [("growth.jpg", ".png"), ("growth", ".png"), ("missing/growth.png", "missing")]
)
def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    tool, tmp_path, monkeypatch, capsys, out, named
):
    monkeypatch.setattr(tool, "_measure", lambda *_: pytest.fail("it measures"))
    arguments = ["--out", str(tmp_path / out), "--device", "cpu"]
    assert tool.run(tool.main, tool.GrowthConfig, program="raster_growth", arguments=arguments) == 2
    assert named in capsys.readouterr().err
