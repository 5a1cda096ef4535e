import subprocess
import sys

import numpy as np
import pytest

from samira_warp.io.images import read_image
from samira_warp.support.errors import UserError
from samira_warp.tracker.plots import write_plots

FRAMES = 50


def curves(**changes):
    seconds = np.arange(FRAMES) / 25
    wave = np.sin(3 * seconds)
    return {
        "seconds": seconds,
        "angles": np.stack([10 * wave, 30 * wave, 0 * wave], axis=1),
        "translation": 0.01 * np.stack([wave, -wave, 0 * wave], axis=1),
        "openness": {"eyes": 0.5 + 0.5 * wave, "mouth": 0 * wave},
        "error": {"landmarks": 1.5 + wave},
        **changes,
    }


def test_curves_are_a_picture(tmp_path):
    write_plots(tmp_path / "plot.png", **curves())
    picture = read_image(tmp_path / "plot.png", channels=3)
    assert picture.shape == (800, 1000, 3)
    panels = np.split(picture, 4)
    # white paper, and coloured lines in every panel
    for panel in panels:
        assert (panel == 1).all(axis=2).mean() > 0.5
        assert (np.ptp(panel, axis=2) > 0.3).sum() > 500
    write_plots(tmp_path / "again.png", **curves())
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "plot.png").read_bytes()


def test_what_was_not_seen_is_a_gap(tmp_path):
    """And a tracking may have nothing that opens."""
    error = np.full(FRAMES, 1.5)
    write_plots(tmp_path / "whole.png", **curves(openness={}, error={"landmarks": error}))
    error[20:30] = np.nan
    write_plots(tmp_path / "gap.png", **curves(openness={}, error={"landmarks": error}))
    whole, gap = (read_image(tmp_path / f"{name}.png", channels=3)[570:740] for name in ("whole", "gap"))
    columns = (np.ptp(whole, axis=2) > 0.3).any(axis=0).sum() - (np.ptp(gap, axis=2) > 0.3).any(axis=0).sum()
    # 11 of 49 steps, of an axis of some 850 pixels
    assert 150 < columns < 230


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("angles", {"angles": np.zeros((FRAMES, 2))}),
        ("translation", {"translation": np.zeros((FRAMES + 1, 3))}),
        ("mouth", {"openness": {"mouth": np.zeros(3)}}),
        ("landmarks", {"error": {"landmarks": np.zeros((FRAMES, 1))}}),
    ],
)
def test_arrays_of_other_shapes_are_refused_by_name(tmp_path, name, changes):
    with pytest.raises(UserError, match=f"^{name}: expected an array of shape"):
        write_plots(tmp_path / "plot.png", **curves(**changes))
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UserError, match=r"samira-warp\[track\]"):
        write_plots(tmp_path / "plot.png", **curves())
    assert not list(tmp_path.iterdir())


def test_matplotlib_is_not_loaded_before_it_draws():
    code = "import sys, samira_warp.tracker.plots; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
