import subprocess
import sys

import numpy as np
import pytest
import torch
from plyfile import PlyData
from subjects import TESTS
from warm_start import warm_python

from samira_warp import Avatar
from samira_warp.avatar import read_frames
from samira_warp.light import encode_srgb

TOOL = TESTS.parent / "tools" / "export_ply.py"

STANDARD = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    *(f"f_dc_{i}" for i in range(3)),
]
STANDARD += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


@pytest.fixture(scope="module")
def tool():
    """The tool's module: run once as a process, and from then on in this one."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("export_ply", TOOL)
    module = importlib.util.module_from_spec(spec)
    sys.modules["export_ply"] = module
    spec.loader.exec_module(module)
    return module


def export(tool, *arguments):
    options = [*map(str, arguments), "--albedo"]
    return tool.run(tool.main, tool.ExportConfig, program="export_ply", arguments=options)


def columns(vertex, *names):
    return np.stack([vertex[name] for name in names], axis=1)


def test_the_tool_itself_writes_the_standard_columns_in_order(tiny_run, tmp_path):
    path = tmp_path / "avatar.ply"
    command = [*warm_python(), str(TOOL), "--avatar", str(tiny_run), "--out", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    vertex = PlyData.read(str(path))["vertex"]
    assert len(STANDARD) == 17
    assert [column.name for column in vertex.properties] == STANDARD
    assert all(column.val_dtype == "f4" for column in vertex.properties)
    assert vertex.count == len(Avatar.load(tiny_run).gaussians)
    header = path.read_bytes().split(b"end_header")[0].decode().splitlines()
    assert header[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "comment axes: x to the head's left, y down, z to the back" in header


@pytest.mark.parametrize("frame", [0, 3])
def test_values_decode_to_the_moved_gaussians(tiny_run, tool, tmp_path, frame):
    path = tmp_path / "avatar.ply"
    assert export(tool, "--avatar", tiny_run, "--frame", frame, "--out", path) == 0
    vertex = PlyData.read(str(path))["vertex"]
    avatar = Avatar.load(tiny_run)
    with torch.no_grad():
        moved = avatar.move(read_frames(tiny_run)[frame].parameters).gaussians
        opacities, albedo = avatar.gaussians.opacities, encode_srgb(avatar.gaussians.albedo)
    down_forward = np.float32([1.0, -1.0, -1.0])
    np.testing.assert_array_equal(columns(vertex, "x", "y", "z"), down_forward * moved.means.numpy())
    np.testing.assert_array_equal(columns(vertex, "nx", "ny", "nz"), down_forward * moved.normals.numpy())
    w, x, y, z = torch.nn.functional.normalize(moved.quaternions, dim=1).unbind(dim=1)
    turned = torch.stack([-x, w, -z, y], dim=1)  # half a turn about x, and then the rotation
    np.testing.assert_array_equal(columns(vertex, *(f"rot_{i}" for i in range(4))), turned.numpy())
    # what a viewer does: exp, sigmoid, and 0.5 + Y_00 f_dc
    np.testing.assert_allclose(
        np.exp(columns(vertex, "scale_0", "scale_1", "scale_2")), moved.scales.numpy(), rtol=1e-5
    )
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), opacities.numpy(), rtol=1e-5)
    shown = 0.5 + np.sqrt(1 / (4 * np.pi)) * columns(vertex, "f_dc_0", "f_dc_1", "f_dc_2")
    np.testing.assert_allclose(shown, albedo.numpy(), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--frame", "6"], "0 to 5"),
        (["--frame=-1"], "0 to 5"),
        (["--out", "avatar.txt"], "expected ply or "),
        (["--out", "nowhere/avatar.ply"], "nowhere"),
        (["--avatar", "nowhere"], "nowhere"),
    ],
)
def test_mistakes(tiny_run, tool, tmp_path, capsys, monkeypatch, options, named):
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    arguments = ["--avatar", tiny_run] * ("--avatar" not in options) + ["--out", "a.ply"] * (
        "--out" not in options
    )
    assert export(tool, *arguments, *options) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1
    assert named in message[0]
    assert not list(tmp_path.iterdir())
