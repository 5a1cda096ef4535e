import importlib.util
import sys

import pytest
from subjects import TESTS

from samira_warp.images import read_image


@pytest.fixture
def tool():
    pytest.importorskip("matplotlib")
    spec = importlib.util.spec_from_file_location("raster_growth", TESTS.parent / "tools" / "raster_growth.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["raster_growth"] = module
    spec.loader.exec_module(module)
    return module


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
    # half of 200 are behind the camera: as many intersections as 100 have, give or take their sizes
    assert intersections[7] < 0.7 * intersections[1]
    assert read_image(tmp_path / "growth.png", channels=3).shape == (900, 1200, 3)
