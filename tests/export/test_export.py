"""``python -m samira_warp.export``: the albedo of a frame, or the frame under a light."""

import functools
import subprocess
import sys
from typing import get_args

import numpy as np
import pytest
import torch
from plyfile import PlyData
from subjects import TESTS
from warm_start import warm_python

from samira_warp.avatar import Avatar, read_frames
from samira_warp.export.__main__ import command
from samira_warp.export.config import Format
from samira_warp.export.formats import FORMATS
from samira_warp.export.ply import write_ply
from samira_warp.io.images import write_exr
from samira_warp.light import Environment, decode_srgb, encode_srgb
from samira_warp.light.brdf import brdf_table
from samira_warp.light.equirect import equirect_directions
from samira_warp.reference.shading.deferred import lookup_brdf


def export(*arguments):
    """The verb in this process; its exit status."""
    return command([*map(str, arguments)])


def colors(path):
    """(N, 3) display values as a viewer shows them: 0.5 + Y_00 f_dc."""
    vertex = PlyData.read(str(path))["vertex"]
    f_dc = np.stack([vertex[f"f_dc_{i}"] for i in range(3)], axis=1)
    return torch.from_numpy(0.5 + np.float32(np.sqrt(1 / (4 * np.pi))) * f_dc)


@pytest.fixture(autouse=True)
def small_environments(monkeypatch):
    """Environment maps as cubes of 64 texels: the default's 256 take seconds to filter."""
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=64))


@pytest.fixture(scope="module")
def lights(tmp_path_factory):
    """Two maps, one uniform, one bright on a camera's right, and a folder of maps."""
    folder = tmp_path_factory.mktemp("lights")
    write_exr(folder / "white.exr", np.ones((16, 32, 3), np.float32))
    x = equirect_directions(16).numpy()[..., :1]
    write_exr(folder / "right.exr", np.maximum(x, 0.0) ** 2 * np.ones(3, np.float32))
    (folder / "maps").mkdir()
    write_exr(folder / "maps" / "a.exr", np.ones((8, 16, 3), np.float32))
    return folder


def test_a_frame_is_written_and_said(tiny_run, tmp_path):
    path = tmp_path / "frame.ply"
    options = ["--avatar", tiny_run, "--format", "ply", "--frame", "1", "--albedo", "--out", path]
    verb = [sys.executable, "-m", "samira_warp.export", *options]
    done = subprocess.run(verb, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    count, frame = len(Avatar.load(tiny_run).gaussians), read_frames(tiny_run)[1]
    assert done.stderr.splitlines()[-1] == f"{path}: {count:,} splats of frame {frame.name}"
    assert done.stdout == ""
    assert f"comment frame: {frame.name}\n".encode() in path.read_bytes()
    shown = encode_srgb(Avatar.load(tiny_run).gaussians.albedo).detach()
    torch.testing.assert_close(colors(path), shown, atol=1e-6, rtol=0)


def test_the_tool_writes_the_same_file(tiny_run, tmp_path):
    """To the byte, each in a process of its own: where films were tracked, sums were seen to differ."""
    options = ["--avatar", str(tiny_run), "--out"]
    tool = [*warm_python(), str(TESTS.parent / "tools" / "export_ply.py"), *options]
    verb = [*warm_python(), "-m", "samira_warp.export", *options]
    for program, name in ((tool, "tool.ply"), (verb, "verb.ply")):
        subprocess.run([*program, str(tmp_path / name)], check=True, timeout=240, capture_output=True)
    assert (tmp_path / "tool.ply").read_bytes() == (tmp_path / "verb.ply").read_bytes()


def test_under_a_white_furnace_a_splat_reflects_what_its_material_says(tiny_run, tmp_path, lights):
    """E_d = E_s = 1 all around, exposed by a half: C = (tau_d a' (1 - f) + tau_s v_s (f B_x + B_y)) / 2.

    a' = a v / (1 - a (1 - o)): of a uniform light arrives what the sky leaves open, v = o, and bounces.
    """
    path = tmp_path / "lit.ply"
    light = ("--env", lights / "white.exr", "--exposure", 0.5, "--tone-map", "none")
    assert export("--avatar", tiny_run, "--frame", 2, "--out", path, *light) == 0
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[2]
    with torch.no_grad():
        motion = avatar.move(frame.parameters)
        environment = Environment.from_cubemaps(*(torch.ones(6, 16, 16, 3),) * 2)
        occlusion = avatar.occluder.occlude(motion.head)
        surface = avatar.surface(
            motion, arrival=avatar.arrival(occlusion, environment.filtered(), frame.camera)
        )
        towards = torch.nn.functional.normalize(frame.camera.center - motion.gaussians.means, dim=1)
        cosine = (surface.normal * towards).sum(dim=1, keepdim=True)
        scale, bias = lookup_brdf(brdf_table(torch.device("cpu")), surface.roughness, cosine)
        bounced = surface.albedo / (1 - surface.albedo * (1 - surface.ambient_occlusion))
        diffuse = surface.response_diffuse * surface.visibility * bounced * (1 - surface.specular)
        glossy = surface.response_specular * surface.visibility_specular * (surface.specular * scale + bias)
    # filtering keeps a uniform light to 1e-3, as the furnace of `bench light` shows
    torch.testing.assert_close(decode_srgb(colors(path)), 0.5 * (diffuse + glossy), rtol=2e-3, atol=1e-5)


def test_a_light_turns(tiny_run, tmp_path, lights):
    """What is on the camera's right lights the face from before it when it is turned by -90 degrees."""
    means = {}
    for turn in (-90, 90):
        path = tmp_path / f"{turn}.ply"
        light = ("--env", lights / "right.exr", f"--rotate={turn}", "--exposure", "auto")
        assert export("--avatar", tiny_run, "--out", path, *light) == 0
        facing = torch.from_numpy(-PlyData.read(str(path))["vertex"]["nz"]) > 0.7
        assert facing.sum() > 20
        means[turn] = decode_srgb(colors(path)[facing]).mean()
    assert means[-90] > 3 * means[90]


def test_the_learned_light_is_the_default(tiny_run, tmp_path):
    path = tmp_path / "lit.ply"
    assert export("--avatar", tiny_run, "--out", path) == 0
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[0]
    with torch.no_grad():
        image = avatar.render(frame.parameters, frame.camera).image
        seen = avatar.rasterize(avatar.move(frame.parameters), frame.camera).alpha[..., 0] > 0.99
    facing = torch.from_numpy(-PlyData.read(str(path))["vertex"]["nz"]) > 0.3
    # the splats that face the camera are what its picture is blended of
    torch.testing.assert_close(colors(path)[facing].mean(dim=0), image[seen].mean(dim=0), atol=0.05, rtol=0)


def test_every_format_of_the_options_has_a_writer():
    assert list(get_args(Format)) == list(FORMATS)
    assert all(name == entry.name for name, entry in FORMATS.items())


def test_a_sequence_is_numbered_files_of_the_frames_that_are_asked_for(tiny_run, tmp_path, capsys):
    folder = tmp_path / "film"
    options = ("--avatar", tiny_run, "--format", "ply-sequence", "--albedo", "--out", folder)
    assert export(*options, "--split", "train", "--frames", "1::2") == 0
    assert sorted(path.name for path in folder.iterdir()) == ["frame_0000.ply", "frame_0001.ply"]
    train = [frame for frame in read_frames(tiny_run) if frame.part == "train"]
    avatar = Avatar.load(tiny_run)
    for path, frame in zip(sorted(folder.iterdir()), train[1::2], strict=True):
        with torch.no_grad():
            means = avatar.move(frame.parameters).gaussians.means
        np.testing.assert_array_equal(PlyData.read(str(path))["vertex"]["y"], -means[:, 1].numpy())
    capsys.readouterr()
    assert export(*options, "--frames", "0") == 0
    assert f"note: {folder} keeps 1 of an earlier sequence, such as frame_0001.ply" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--albedo", "--rotate", "30"], "--rotate: expected a light, found --albedo"),
        (["--albedo", "--env", "white.exr"], "--env: expected a light, found --albedo"),
        (["--albedo", "--exposure", "2"], "--exposure: expected a light, found --albedo"),
        (["--frames", "0:2"], "--frames: expected a format of many frames, found --format ply"),
        (["--format", "ply-sequence", "--frames", "7", "--out", "film"], "--frames: expected some of the 2"),
        (["--format", "ply-sequence", "--frame", "0", "--out", "film"], "--frame: expected one frame's"),
        (["--format", "ply-sequence", "--out", "white.exr"], "expected a folder"),
        (["--out", "film"], "--format: expected ply or ply-sequence or spz or "),
        (["--spz-version", "2"], "--spz-version: expected --format spz, found --format ply"),
        (["--out", "frame.spz", "--spz-version", "5"], "--spz-version"),
        (["--format", "gltf-splats", "--out", "frame.gltf"], "expected a file name ending in .glb"),
        (["--format", "usd", "--out", "frame.usd"], "ending in .usdc or .usda or .usdz"),
        (["--env", "white.exr", "--rotate", "nan"], "--rotate: expected degrees"),
        (["--env", "white.exr", "--exposure", "-1"], "--exposure"),
        (["--env", "missing.exr"], "missing.exr"),
        (["--env", "maps"], "maps: expected a learned light"),
        (["--env", "white.exr", "white.exr", "white.exr"], "3 files"),
        (["--frame", "6"], "--frame: expected 0 to 5, found 6"),
        (["--out", "frame.png"], "no formats whose files end in '.png'"),
        (["--format", "ply", "--out", "frame.png"], "frame.png: expected a file name ending in .ply"),
        (["--format", "obj"], "--format"),
    ],
    ids=lambda value: "=".join(value) if isinstance(value, list) else "",
)
def test_mistakes_are_one_line_and_leave_no_file(tiny_run, lights, monkeypatch, capsys, options, named):
    monkeypatch.chdir(lights)
    capsys.readouterr()
    before = sorted(lights.iterdir())
    out = [] if "--out" in options else ["--out", "frame.ply"]
    try:
        status = export("--avatar", tiny_run, *out, *options)
    except SystemExit as end:  # an option that does not parse ends the process
        status = end.code
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line
    assert sorted(lights.iterdir()) == before


def half_written(splats, path, **_):
    """As a writer that is interrupted."""
    path.write_bytes(b"ply")
    raise KeyboardInterrupt


def test_an_interrupt_leaves_what_was_there(tiny_run, tmp_path, monkeypatch):
    path = tmp_path / "frame.ply"
    path.write_bytes(b"earlier")
    monkeypatch.setattr("samira_warp.export.ply.write_ply", half_written)
    assert export("--avatar", tiny_run, "--albedo", "--out", path) == 130
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("frame.ply", b"earlier")]


def test_an_interrupted_sequence_is_whole_files(tiny_run, tmp_path, monkeypatch):
    folder = tmp_path / "film"
    options = ("--avatar", tiny_run, "--albedo", "--format", "ply-sequence", "--out", folder)
    writers = iter([half_written, write_ply, half_written])
    monkeypatch.setattr(
        "samira_warp.export.ply_sequence.write_ply", lambda *given, **more: next(writers)(*given, **more)
    )
    assert export(*options) == 130
    assert not folder.exists()
    assert export(*options) == 130
    assert [path.name for path in folder.iterdir()] == ["frame_0000.ply"]
    count = len(Avatar.load(tiny_run).gaussians)
    assert PlyData.read(str(folder / "frame_0000.ply"))["vertex"].count == count


def test_options_are_typed_without_torch():
    code = "import sys, samira_warp.export.config; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
