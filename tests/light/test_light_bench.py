import functools
import json

import numpy as np
import pytest
import torch

from samira_warp.bench import light, light_table
from samira_warp.io.images import write_exr
from samira_warp.light import Environment
from samira_warp.support.errors import UserError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with one smooth map. Cubes of 64 texels hold it: the default's 256 take seconds to filter."""
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=64))
    rows = np.linspace(2.0, 0.5, 16)[:, None, None] * np.array([0.8, 1.0, 1.2])
    write_exr(tmp_path / "sky.exr", np.broadcast_to(rows, (16, 32, 3)).astype(np.float32))
    return tmp_path


def test_the_json_is_one_object_with_its_errors_in_bounds(folder, monkeypatch, capsys):
    monkeypatch.setattr(light, "ENVIRONMENT_SIZE", 32)
    monkeypatch.setattr(light, "SHADED_PIXELS", 256)
    monkeypatch.setattr(light_table, "SAMPLES", 1600)
    monkeypatch.setattr(light_table, "SPHERE_ROUGHNESS", (0.1, 0.5))
    light.main("cpu", True, folder)
    row = json.loads(capsys.readouterr().out)
    assert row["hardware"]
    assert row["furnace_max_error"] < 1e-3
    assert row["bruteforce_max_error"] < 1e-3
    assert row["environment_max_error"] < 1e-3
    assert min(row[name] for name in ("step_ms", "shade_ms", "shade_adjoint_ms", "environment_ms")) > 0
    assert [entry["object"] for entry in row["monte_carlo"]] == [
        *(f"sphere {r:g}" for r in light_table.SPHERE_ROUGHNESS),
        "head",
    ]
    # A light without detail: what is left is the truth's own noise, some 0.85 / sqrt(1600), and less than a
    # per cent of ours.
    for entry in row["monte_carlo"]:
        assert entry["map"] == "sky"
        assert entry["color"] < 2 * entry["noise"] + 0.01
        assert 0 < entry["noise"] < 0.03


def test_the_table_has_a_line_per_map(folder, monkeypatch, capsys):
    monkeypatch.setattr(light_table, "SAMPLES", 50)
    monkeypatch.setattr(light_table, "SPHERE_ROUGHNESS", (0.5,))
    light_table.print_light_table(light_table.light_table(folder, torch.device("cpu")))
    lines = capsys.readouterr().out.strip().splitlines()
    assert len(lines) == 3
    assert len(lines[1].split()) == len(lines[2].split()) + 2  # "L_s head" and "C_fg head"


def test_a_grey_map_is_read_and_a_cross_is_refused(tmp_path):
    write_exr(tmp_path / "grey.exr", np.ones((8, 16, 1), np.float32))
    assert light_table._read_panorama(tmp_path / "grey.exr").pixels.shape == (8, 16, 3)
    write_exr(tmp_path / "grey.exr", np.ones((12, 16, 3), np.float32))
    with pytest.raises(UserError, match=r"grey\.exr: expected an equirectangular map.*, found a cube cross"):
        light_table.light_table(tmp_path, torch.device("cpu"))


def test_a_folder_without_maps_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"\.hdr or \.exr"):
        light_table.light_table(tmp_path, torch.device("cpu"))
