"""The table of an avatar's surface beside the true one."""

import functools
import importlib
import json
import shutil

import numpy as np
import pytest
import torch
from subjects import TESTS

from samira_warp.avatar import Avatar
from samira_warp.avatar.storage import find_avatar
from samira_warp.data import open_sequence
from samira_warp.io.images import write_png
from samira_warp.light import Environment, encode_srgb


@pytest.fixture
def tool(monkeypatch):
    """The tool, with environment maps as cubes of 32 texels."""
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=32))
    return importlib.import_module("surface_table")


def rows_of(tool, run, data, capsys):
    capsys.readouterr()
    arguments = ["--avatar", str(run), "--data", str(data), "--resolution", "48", "--json"]
    assert tool.run(tool.main, tool.SurfaceConfig, program="surface_table", arguments=arguments) == 0
    return {row.pop("what"): row for row in json.loads(capsys.readouterr().out)}


@torch.no_grad()
def with_the_avatars_own(tool, run, dataset, folder):
    """A dataset whose truth is what an avatar shows."""
    data = shutil.copytree(dataset, folder)
    avatar, sequence = Avatar.load(find_avatar(run)), open_sequence(data)
    skin = tool.SkinMask.of(sequence)
    for frame in (sequence.frames[index] for index in sequence.test):
        name, seen = f"{frame.name}.png", tool.Seen.of(frame, avatar, skin, resolution=48)
        write_png(data / "gt" / "normal" / name, (0.5 + 0.5 * seen.gbuffer.normal).numpy())
        for layer in ("roughness", "specular"):
            values = np.rint(65535.0 * getattr(seen.gbuffer, layer)[..., 0].numpy()).astype(np.uint16)
            write_png(data / "gt" / layer / name, values)
    for light in tool.read_lights(data):
        for path in light.truth.iterdir() if light.name != "capture" else ():
            frame = next(frame for frame in sequence.frames if frame.name == path.stem)
            filtered = light.environment.filtered()
            seen = tool.Seen.of(frame, avatar, skin, resolution=48, light=filtered)
            write_png(path, seen.image.numpy())
            mirrored = encode_srgb(tool.mirrored_light(seen)).numpy()
            write_png(data / "gt" / "highlights" / light.name / path.name, mirrored)
    return data


def test_what_there_is_truth_of_has_a_row(tiny_run, stand_in_dataset, tool, tmp_path, capsys):
    rows = rows_of(tool, tiny_run, stand_in_dataset, capsys)
    lights = [f"light that skin mirrors, {light}, x 100" for light in ("dusk", "lamp", "stage", "window")]
    materials = ["roughness of skin, x 100", "reflectance of skin, x 100"]
    normals = ["normals, degrees", "normals below 3 px, degrees", "what that takes away, degrees"]
    assert set(rows) == {*normals, *materials, *lights, "skin under the lamp, dB"}
    # the stand-in's finish, in 16 bits
    assert rows["roughness of skin, x 100"]["truth"] == pytest.approx(50.0, abs=1e-3)
    assert rows["reflectance of skin, x 100"]["truth"] == pytest.approx(3.0, abs=1e-3)
    assert 5.0 < rows["skin under the lamp, dB"]["error"] < 40.0
    data = shutil.copytree(stand_in_dataset, tmp_path / "less")
    for layer in ("roughness", "specular", "relight", "highlights"):
        shutil.rmtree(data / "gt" / layer)
    assert rows_of(tool, tiny_run, data, capsys) == {name: rows[name] for name in normals}


def test_an_avatar_that_is_the_truth_has_no_error(tiny_run, stand_in_dataset, tool, tmp_path, capsys):
    data = with_the_avatars_own(tool, tiny_run, stand_in_dataset, tmp_path / "own")
    rows = rows_of(tool, tiny_run, data, capsys)
    assert rows.pop("skin under the lamp, dB")["error"] == 100.0
    # normals in bytes are off by up to half of 2 / 255 in each axis: 0.39 degrees if all are
    for name in [name for name in rows if name.endswith("degrees")]:
        assert rows.pop(name)["error"] < 0.39
    # 16 bits, and bytes of an sRGB curve that is nowhere steeper than 12.92 and whose inverse than 2.3
    for name in list(rows):
        assert rows.pop(name)["error"] < (100 * 2.3 * 0.5 / 255 if "mirrors" in name else 1e-3)


def test_a_low_pass_takes_no_account_of_what_does_not_count(tool, generator):
    where = torch.rand(12, 9, generator=generator) > 0.3
    layer = torch.where(where[..., None], torch.tensor([0.2, -0.4, 0.7]), torch.tensor(9.0))
    found = tool.low_pass(layer, where, 2.0)
    # float32 sums of some hundred weights
    torch.testing.assert_close(found, torch.tensor([0.2, -0.4, 0.7]).expand(12, 9, 3), rtol=1e-5, atol=0.0)


def test_a_dataset_without_true_normals_is_named(tiny_run, tiny_dataset, tool, capsys):
    arguments = ["--avatar", str(tiny_run), "--data", str(tiny_dataset)]
    capsys.readouterr()
    assert tool.run(tool.main, tool.SurfaceConfig, program="surface_table", arguments=arguments) == 2
    assert str(tiny_dataset / "gt" / "normal") in capsys.readouterr().err
