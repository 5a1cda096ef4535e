"""The dataset of the built-in subject: whole, readable, exact, and the same every time."""

import importlib
import io
import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from filelock import FileLock
from stand_in import NAMES, PLAN, contents, stand_in
from subjects import TESTS
from warm_start import warm_python

from samira_subject import make, plan
from samira_subject.lights import panorama_of, resampled
from samira_subject.make import make_subject
from samira_subject.performance import perform
from samira_subject.plan import VERSION
from samira_subject.sky import CAPTURE
from samira_subject.studio import DISTANCE
from samira_warp.data import open_sequence
from samira_warp.head import Rig
from samira_warp.io.files import read_json
from samira_warp.io.images import image_size, read_image, write_exr
from samira_warp.light import Environment, LightRig, equirect_directions
from samira_warp.light.equirect import row_solid_angles
from samira_warp.support.cli import run

SCRIPT = TESTS / "subject" / "stand_in.py"


@pytest.fixture
def dataset(stand_in_dataset):
    """The stand-in's dataset, made by two threads."""
    return stand_in_dataset


def command(folder, *options, threads=1):
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
    return subprocess.Popen(
        [*warm_python(), str(SCRIPT), "--out", str(folder), *options],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_it_opens_with_the_frames_and_parameters_that_were_played(dataset):
    sequence = open_sequence(dataset)
    assert (len(sequence.train), len(sequence.test), sequence.notes) == (PLAN.train, PLAN.test, ())
    played = perform(NAMES, train=PLAN.train, test=PLAN.test, seed=PLAN.seed)
    for index, frame in enumerate(sequence.frames):
        expected = played.frame(index)
        for name in ("translation", "rotations", "expression"):
            assert torch.equal(getattr(frame.parameters, name), getattr(expected, name))
        with np.load(frame.parameters_path) as arrays:
            for key, track in (
                ("rotation", played.rotation),
                ("neck_pose", played.neck),
                ("jaw_pose", played.jaw),
                ("eyes_pose", played.eyes),
            ):
                assert np.array_equal(arrays[key], track[index : index + 1].numpy()), key
        assert (frame.albedo_path is not None) == (index in sequence.train)


def test_everything_that_the_layout_names_is_there(dataset):
    tests = [f"{index:05d}_00.png" for index in range(PLAN.train, PLAN.train + PLAN.test)]
    for layer in ("albedo", "normal", "roughness", "specular"):
        assert sorted(path.name for path in (dataset / "gt" / layer).iterdir()) == tests
    for name in PLAN.lights:
        relit = tests[: PLAN.relit]
        assert [path.name for path in (dataset / "gt" / "highlights" / name).iterdir()] == relit
        described = dataset / "gt" / ("capture_light.json" if name == CAPTURE else f"relight/{name}.json")
        light = read_json(described)
        assert Environment.load(
            dataset / light["file"], rotate=light["azimuth_degrees"], exposure=light["exposure"], size=32
        )
        if name != CAPTURE:
            assert [path.name for path in (dataset / "gt" / "relight" / name).iterdir()] == relit
    facts = read_json(dataset / "dataset.json")
    assert (facts["frames"], facts["seed"]) == (PLAN.train + PLAN.test, PLAN.seed)
    assert json.loads((dataset / "transforms_val.json").read_text())["frames"] == []


def test_pictures_stand_on_white_and_normals_are_unit_vectors(dataset):
    for index in range(PLAN.train + PLAN.test):
        name = f"{index:05d}_00.png"
        assert image_size(dataset / "images" / name) == (PLAN.size, PLAN.size)
        mask = read_image(dataset / "fg_masks" / name, channels=1)
        assert 0.1 < mask.mean() < 0.9
        for layer in ("images", "albedo" if index < PLAN.train else "gt/albedo"):
            assert (read_image(dataset / layer / name, channels=3)[mask[..., 0] == 0] == 1).all()
        if index >= PLAN.train:
            normal = 2 * read_image(dataset / "gt" / "normal" / name, channels=3) - 1
            lengths = np.linalg.norm(normal, axis=2)
            # eight bits are good to 1 / 255 in each axis
            np.testing.assert_allclose(lengths[mask[..., 0] == 1], 1.0, atol=np.sqrt(3) / 255)
            np.testing.assert_allclose(lengths[mask[..., 0] == 0], 0.0, atol=1.01 * np.sqrt(3) / 255)


def test_the_surface_is_written_as_it_is(dataset):
    """The stand-in's finish is everywhere the same: 16 bits of it, and nothing where there is no head."""
    for index in range(PLAN.train, PLAN.train + PLAN.test):
        name = f"{index:05d}_00.png"
        head = read_image(dataset / "fg_masks" / name, channels=1) > 0
        for layer, value in (("roughness", 0.5), ("specular", 0.03)):
            found = read_image(dataset / "gt" / layer / name, channels=1)
            np.testing.assert_allclose(found, value * head, atol=0.5 / 65535 + 1e-7)


def test_specular_light_is_some_of_the_light(dataset):
    name = f"{PLAN.train:05d}_00.png"
    mask = read_image(dataset / "fg_masks" / name, channels=1)[..., 0]
    for light in PLAN.lights:
        folder = dataset / ("images" if light == CAPTURE else f"gt/relight/{light}")
        picture, mirrored = (
            read_image(path / name, channels=3) for path in (folder, dataset / "gt" / "highlights" / light)
        )
        # both are rounded to a byte
        assert (mirrored[mask == 1] <= picture[mask == 1] + 1.01 / 255).all()
        assert mirrored[mask == 1].mean() > 0.02


def test_the_orbit_is_a_dataset_of_two_poses_from_around(dataset):
    """It opens by itself, all but what training saw is to test on, and cameras stand where names say."""
    film, orbit = open_sequence(dataset), open_sequence(dataset / "gt" / "orbit")
    assert [orbit.frames[index].name for index in orbit.train] == ["neutral_yaw+000_pitch+00"]
    assert len(orbit.frames) == 2 * len(PLAN.orbit)
    assert (orbit.template.hash, orbit.notes) == (film.template.hash, ())
    assert torch.equal(orbit.shape, film.shape)
    angles = {row["name"]: row for row in read_json(dataset / "gt" / "orbit" / "orbit.json")["frames"]}
    middle = film.frames[0].camera.center - torch.tensor([0.0, 0.0, DISTANCE])
    for frame in orbit.frames:
        yaw, pitch = (math.radians(angles[frame.name][key]) for key in ("yaw", "pitch"))
        ahead = [math.cos(pitch) * math.sin(yaw), math.sin(pitch), math.cos(pitch) * math.cos(yaw)]
        found = frame.camera.center - middle
        torch.testing.assert_close(found, DISTANCE * torch.tensor(ahead), rtol=0.0, atol=1e-6)
        # the middle of the head is in the middle of the picture, and up is up
        seen = frame.camera.world_to_camera @ torch.tensor([*middle.tolist(), 1.0])
        torch.testing.assert_close(seen, torch.tensor([0.0, 0.0, DISTANCE, 1.0]), rtol=0.0, atol=1e-6)
        assert frame.camera.world_to_camera[1, 1] < -0.7
        assert abs(frame.camera.world_to_camera[0, 1]) < 1e-6
        assert not frame.parameters.rotations[:2].any()
        assert 0.1 < read_image(frame.mask_path, channels=1).mean() < 0.9
    poses = [orbit.frames[row].parameters for row in (0, -1)]
    assert torch.equal(poses[0].expression, film.frames[0].parameters.expression)
    widest = max((film.frames[index].parameters for index in film.test), key=lambda p: p.rotations[2, 0])
    assert torch.equal(poses[1].rotations[2:], widest.rotations[2:])


@pytest.mark.parametrize("which", ["film", "orbit"])
def test_the_tracked_mesh_lies_on_the_masks(dataset, which):
    sequence = open_sequence(dataset if which == "film" else dataset / "gt" / "orbit")
    rig = Rig.build(sequence.template)
    for frame in sequence.frames:
        camera, vertices = frame.camera, rig.pose(frame.parameters, sequence.shape).vertices
        seen = vertices @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        x, y = (
            camera.fx * seen[:, 0] / seen[:, 2] + camera.cx,
            camera.fy * seen[:, 1] / seen[:, 2] + camera.cy,
        )
        mask = read_image(frame.mask_path, channels=1)[..., 0] > 0
        columns, rows = np.nonzero(mask.any(axis=0))[0], np.nonzero(mask.any(axis=1))[0]
        # subdivision draws the coarse sphere's outline in by a sixth of an edge's sagitta: less than a pixel
        # here
        for found, expected in (
            (columns[0], x.min()),
            (columns[-1] + 1, x.max()),
            (rows[0], y.min()),
            (rows[-1] + 1, y.max()),
        ):
            assert abs(found - min(max(float(expected), 0.0), camera.width)) < 2.0


def test_the_same_bytes_in_another_process_by_one_thread(dataset, tmp_path):
    process = command(tmp_path / "again")
    assert process.wait(timeout=300) == 0, process.stderr.read()
    assert contents(dataset) == contents(tmp_path / "again")


def test_another_seed_makes_another_subject(dataset, tmp_path):
    make_subject(tmp_path / "other", replace(PLAN, seed=4, train=1, test=1), stand_in)
    for name in ("images/00000_00.png", "images/00001_00.png", "flame_param/00001.npz"):
        assert (dataset / name).read_bytes() != (tmp_path / "other" / name).read_bytes()


def halves(parent):
    """The folders beside the dataset in which what is made of it is kept."""
    return list(parent.glob(".subject.half-*"))


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_what_ended_early_goes_on_to_the_same_bytes(dataset, tmp_path, number, status):
    """The third picture's mask is half written then; of the last frame of five, all is missing."""
    folder = tmp_path / "subject"
    process = command(folder, "--stall-at", "fg_masks/00002_00.png")
    said = []
    for line in process.stderr:
        said.append(line)
        if "stalled" in line:
            process.send_signal(number)
    assert process.wait(timeout=60) == status, said
    (half,) = halves(tmp_path)
    assert [path.name for path in tmp_path.iterdir() if "lock" not in path.name] == [half.name]
    if number == signal.SIGINT:
        kept = f"stopped: 2 of 15 pictures are kept in {half}; the same command goes on with the others\n"
        assert said[-1] == kept
    whole = (half / "images" / "00001_00.png").stat().st_ino

    again = command(folder)
    assert again.wait(timeout=300) == 0, again.stderr.read()
    assert f"going on where it stopped: 2 of 15 pictures are kept in {half}\n" in again.stderr.read()
    assert (folder / "images" / "00001_00.png").stat().st_ino == whole
    assert contents(folder) == contents(dataset)
    assert list(tmp_path.iterdir()) == [folder]


def test_ctrl_c_is_heard_while_rays_are_cast(tmp_path):
    process = command(tmp_path / "subject", "--train", "500")
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob(".subject.half-*/images/00002*")) and time.monotonic() < deadline:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    said = process.stderr.read()
    assert "of 512 pictures are kept in" in said.splitlines()[-1]
    assert "Traceback" not in said
    (half,) = halves(tmp_path)
    for path in half.glob("images/[0-9]*.png"):
        assert read_image(path, channels=3).shape == (PLAN.size, PLAN.size, 3)


@pytest.fixture
def full_disk(monkeypatch):
    """A disk that takes so many pictures more."""

    def fill(room):
        write = make.write_png
        left = iter(range(room))

        def write_while_room(path, pixels):
            if next(left, None) is None:
                path.write_bytes(b"half")
                raise OSError(28, "No space left on device", str(path))
            write(path, pixels)

        monkeypatch.setattr(make, "write_png", write_while_room)

    yield fill
    monkeypatch.undo()


def test_a_full_disk_keeps_what_it_took(dataset, tmp_path, full_disk, monkeypatch, capsys):
    folder = tmp_path / "subject"
    full_disk(7)
    with pytest.raises(OSError, match="No space left"):
        make_subject(folder, PLAN, stand_in)
    (half,) = tmp_path.iterdir()
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == f"stopped: 2 of 15 pictures are kept in {half}; the same command goes on with the others"
    monkeypatch.undo()
    make_subject(folder, PLAN, stand_in)
    assert contents(folder) == contents(dataset)
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("other", ["plan", "version"])
def test_half_of_something_else_is_thrown_away(dataset, tmp_path, full_disk, monkeypatch, capsys, other):
    folder = tmp_path / "subject"
    full_disk(7)
    if other == "version":
        monkeypatch.setattr(plan, "VERSION", VERSION + 1)
    with pytest.raises(OSError, match="No space left"):
        make_subject(folder, replace(PLAN, seed=PLAN.seed + (other == "plan")), stand_in)
    (before,) = halves(tmp_path)
    monkeypatch.undo()
    full_disk(0)
    with pytest.raises(OSError, match="No space left"):
        make_subject(folder, PLAN, stand_in)
    assert "going on" not in capsys.readouterr().err
    assert not before.exists()
    monkeypatch.undo()
    make_subject(folder, PLAN, stand_in)
    assert contents(folder) == contents(dataset)


def test_a_finished_one_stays_until_another_is_whole(tmp_path, full_disk, monkeypatch):
    folder = tmp_path / "subject"
    folder.mkdir()
    (folder / "mine").write_text("before")
    full_disk(7)
    with pytest.raises(OSError, match="No space left"):
        make_subject(folder, PLAN, stand_in)
    assert (folder / "mine").read_text() == "before"
    monkeypatch.undo()
    make_subject(folder, PLAN, stand_in)
    assert not (folder / "mine").exists()
    assert (folder / "dataset.json").is_file()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ([], "--out"),
        (["--out", "{there}"], "a new folder"),
        (["--preview", "a.png", "--out", "{there}"], "a new folder"),
        (["--out", "new", "--preview", "a.jpg"], "a.jpg: expected the name of a .png file"),
        (["--out", "new", "--preview", "nowhere/a.png"], "nowhere: expected a folder"),
        (["--out", "new", "--seed", "-1"], "--seed: expected at least 0"),
        (["--preview", "a.png", "--seed", "2147483648"], "--seed: expected at most 2147483647"),
        (["--out", "new", "--train", "0"], "--train"),
        (["--preview", "a.png", "--light", "moon"], "moon"),
        (["--preview", "a.png", "--lights", "rig.json"], "rig.json: expected a JSON file"),
        (["--out", "new", "--rotate", "nan"], "--rotate: expected degrees"),
        (["--out", "new", "--exposure", "0"], "--exposure: expected a factor above 0"),
        (
            ["--out", "new", "--relight", "window", "there/window.exr"],
            "--relight: expected lights whose names",
        ),
        (["--out", "new", "--relight", "studio"], "--relight: expected lights whose names"),
        (["--out", "new", "--relight", "capture.exr"], "--relight: expected lights whose names"),
        (["--out", "new", "--relight", "sun.exr"], "sun.exr"),
        (["--preview", "a.png", "--frame", "200"], "--frame"),
    ],
)
def test_the_tool_says_in_one_line_what_is_wrong_before_it_makes_anything(
    options, complaint, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    tool = importlib.import_module("make_subject")
    arguments = [option.format(there=tmp_path) for option in options]
    assert run(tool.main, tool.SubjectConfig, program="make_subject", arguments=arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def tool(monkeypatch):
    """The tool, which makes the stand-in with few rays in a few pictures."""
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    module = importlib.import_module("make_subject")
    monkeypatch.setattr(module, "build_cast", lambda seed, texels, hidden: stand_in())
    plan = module.SubjectPlan
    monkeypatch.setattr(
        module, "SubjectPlan", lambda *numbers, **more: plan(*numbers, **more, effort=PLAN.effort)
    )

    def make(out, *options):
        sizes = ("--train", 1, "--test", 2, "--relit", 1, "--resolution", 48, "--no-orbit")
        arguments = [str(word) for word in ("--out", out, *sizes, *options)]
        assert run(module.main, module.SubjectConfig, program="make_subject", arguments=arguments) == 0
        return out

    return make


@pytest.fixture
def sun(tmp_path):
    """A file of one small lamp on the subject's left, which is the picture's right."""
    path = tmp_path / "sun.json"
    lamp = {"kind": "directional", "direction": [1.0, 0.2, 0.4], "irradiance": [3.0, 2.0, 1.0]}
    path.write_text(json.dumps({"lamps": [lamp]}))
    return path


def test_a_film_under_a_users_lights_and_its_truth_under_others(tool, sun, tmp_path):
    write_exr(tmp_path / "hall.exr", (1.0 + equirect_directions(20)).numpy())
    folder = tool(
        tmp_path / "made", "--lights", sun, "--exposure", 1.5, "--relight", tmp_path / "hall.exr", "dusk"
    )
    sequence = open_sequence(folder)
    assert (len(sequence.train), len(sequence.test)) == (1, 2)
    table = importlib.import_module("relight_table")
    lights = {light.name: light for light in table.read_lights(folder)}
    assert list(lights) == ["dusk", "hall", "capture"]
    assert not (folder / "gt" / "orbit").exists()
    for name in ("dusk", "hall"):
        assert [path.name for path in lights[name].truth.iterdir()] == ["00001_00.png"]
    assert read_json(folder / "gt" / "capture_light.json")["exposure"] == 1.5
    # the file is the lamp: `equirect_to_cube` keeps one of a few pixels to a few percent
    mean = lights["capture"].environment.mean_irradiance()
    lamp = Environment.from_rig(LightRig.load(sun), size=64).exposed(1.5).mean_irradiance()
    torch.testing.assert_close(mean, lamp, rtol=3e-2, atol=0.0)
    # what is lit is on the lamp's side
    image, mask = (
        read_image(folder / layer / "00001_00.png", channels=3) for layer in ("images", "fg_masks")
    )
    sides = ((..., slice(0, 24), slice(None)), (..., slice(24, 48), slice(None)))
    left, right = (image[side][mask[side] > 0.9].mean() for side in sides)
    assert right > 2.0 * left
    assert read_json(folder / "dataset.json")["plan"]["lights"] == ["capture", "hall", "dusk"]


def test_a_light_turns_and_adds_up(sun, tmp_path):
    """Turned by 90 degrees what was on the right (+x) is straight ahead (-z): `equirect`'s convention."""
    rig = LightRig.load(sun)
    for light in ("stage", None):
        plain, turned = (panorama_of(light, rig, rotate=degrees).double() for degrees in (0.0, 90.0))
        angles = row_solid_angles(*plain.shape[:2])[:, None, None]
        directions = equirect_directions(len(plain)).double()
        before, after = ((x[..., :1] * angles * directions).sum(dim=(0, 1)) for x in (plain, turned))
        # (x, y, z) to (z, y, -x); pixels are whole columns then, and float32
        torch.testing.assert_close(
            after,
            before[[2, 1, 0]] * before.new_tensor([1, 1, -1]),
            rtol=1e-5,
            atol=1e-6 * float(before.norm()),
        )
    both, alone = (panorama_of("stage", some) for some in (rig, None))
    seen = resampled(both - panorama_of(None, rig), rows=len(alone))
    torch.testing.assert_close(seen, alone, rtol=1e-4, atol=1e-4 * float(both.max()))


@pytest.mark.parametrize(("height", "rows"), [(20, 64), (64, 64), (150, 64)])
@pytest.mark.parametrize("rotate", [0.0, 33.3, -170.0])
def test_a_panorama_at_another_size_keeps_all_its_light(height, rows, rotate, generator):
    panorama = torch.rand(height, 2 * height, 3, generator=generator) ** 8
    found = resampled(panorama, rows=rows, rotate=rotate)
    assert found.shape == (rows, 2 * rows, 3)
    means = [
        (x.double() * row_solid_angles(*x.shape[:2])[:, None, None]).sum(dim=(0, 1))
        for x in (panorama, found)
    ]
    # shares of float32 in sums of up to 300 values
    torch.testing.assert_close(*means, rtol=1e-5, atol=0.0)


def test_two_tools_do_not_make_one_folder(tmp_path, monkeypatch):
    """The second waits for the first, and finds the folder made."""
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    tool = importlib.import_module("make_subject")
    folder = tmp_path / "new"
    first = FileLock(tmp_path / ".new.lock")
    first.acquire()

    class Listener(io.StringIO):
        """Lets the first finish once it is said that it is waited for."""

        def write(self, text):
            if "waiting" in text:
                folder.mkdir()
                first.release()
            return super().write(text)

    monkeypatch.setattr(sys, "stderr", Listener())
    options = ["--out", str(folder)]
    assert run(tool.main, tool.SubjectConfig, program="make_subject", arguments=options) == 2
    waiting, refused = sys.stderr.getvalue().splitlines()
    assert waiting == f"another process is making a subject in {folder}; waiting"
    assert refused.startswith(f"error: {folder}: expected a new folder")
    assert list(folder.iterdir()) == []
