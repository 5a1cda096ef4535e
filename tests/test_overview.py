"""``tools/overview.py``: one labelled row of pictures."""

import functools
import importlib

import numpy as np
from subjects import TESTS

from samira_warp.avatar import Avatar, read_frames
from samira_warp.io.images import read_image, write_exr
from samira_warp.light import Environment
from samira_warp.stage import layer_image


def test_a_row_of_pictures(tiny_run, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    tool = importlib.import_module("overview")
    # cubes of 64 texels: the default's 256 take seconds to filter
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=64))
    radiance = np.full((16, 32, 3), 5.0, np.float32)
    for name in ("even.exr", "bright.exr"):
        write_exr(tmp_path / name, radiance)
    out = tmp_path / "overview.png"
    words = ["--avatar", tiny_run, "--env", tmp_path / "even.exr", tmp_path / "bright.exr"]
    words += ["--frame", 1, "--resolution", 32, "--out", out]
    arguments = [str(word) for word in words]
    assert tool.run(tool.main, tool.OverviewConfig, program="overview", arguments=arguments) == 0
    picture, gap, line = read_image(out, channels=3), 2, 14
    assert picture.shape == (32 + line + 2 * gap, 5 * (32 + gap) + gap, 3)
    panels = [picture[gap : gap + 32, gap + 34 * index : 34 * (index + 1)] for index in range(5)]
    frame = read_frames(tiny_run)[1]
    captured = Avatar.load(tiny_run).requires_grad_(False).render(frame.parameters, frame.camera)
    for panel, layer in zip(panels, ("image", "albedo", "normal"), strict=False):
        expected = layer_image(captured, layer).picture.clamp(0, 1).numpy()
        np.testing.assert_allclose(panel, expected, atol=0.51 / 255)
    # an even light of any brightness is brought to an irradiance of 0.8, which is its radiance
    np.testing.assert_allclose(panels[3][:4, :4], 1.055 * 0.8 ** (1 / 2.4) - 0.055, atol=1.01 / 255)
    assert (picture[gap + 32 :, gap : gap + 32] < 0.5).any()
