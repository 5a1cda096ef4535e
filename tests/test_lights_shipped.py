"""The lights that come with the package."""

import subprocess

import numpy as np
import pytest
from subjects import TESTS
from warm_start import warm_python

from samira_subject.sky import SKIES
from samira_warp import Environment
from samira_warp.io.images import read_image
from samira_warp.light.color import LUMINANCE

TOOL = TESTS.parent / "tools" / "make_lights.py"
SHIPPED = TESTS.parent / "samira_warp" / "assets" / "lights"


def test_the_tool_paints_what_is_there(tmp_path):
    command = [*warm_python(), str(TOOL), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in SHIPPED.iterdir()}
    for path in SHIPPED.iterdir():
        painted, shipped = (read_image(folder / path.name, channels=3) for folder in (tmp_path, SHIPPED))
        # RGBE keeps 8 bits of the largest of three channels; another libm may round one of them otherwise
        quantum = shipped.max(axis=-1, keepdims=True) / 128
        assert (np.abs(painted - shipped) <= quantum).all()


@pytest.mark.parametrize("name", SKIES)
def test_each_is_small_and_of_one_brightness(name):
    path = SHIPPED / f"{name}.hdr"
    assert path.stat().st_size < 6000
    light = Environment.load(path, size=64)
    # RGBE rounds down by half of 1/256 to 1/128 on average; resampling keeps a mean to 1e-3
    assert float(light.mean_irradiance().numpy() @ np.array(LUMINANCE)) == pytest.approx(1.0, abs=0.008)
