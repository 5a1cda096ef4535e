"""All of `bench gpu` that needs no GPU: its refusal, its limits, its table, and its stages at small sizes."""

import json
import os
import subprocess
import sys
import time
from typing import NamedTuple

import pytest
import torch
from subjects import small_preset
from warm_start import warm_python

from samira_warp.bench import gpu, gpu_stages, gswarp_peer, timing, train
from samira_warp.bench.__main__ import main as bench_main
from samira_warp.bench.config import BenchConfig
from samira_warp.bench.disc import make_disc
from samira_warp.bench.gpu import Outcome, Row, Stage
from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.support.cli import fault
from samira_warp.support.errors import UserError

CPU = torch.device("cpu")


def stage(name, program, *, seconds=60.0, lacks=None):
    return Stage(name, seconds, lambda _: [sys.executable, "-c", program], lacks)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_one_line_says_what_is_needed():
    command = [*warm_python(), "-m", "samira_warp", "bench", "gpu"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: bench gpu: expected an NVIDIA GPU that torch and Warp can use: its driver")
    assert torch.__version__ in line


def test_the_cpu_is_no_gpu():
    with pytest.raises(UserError, match=r"NVIDIA GPU.*found --device cpu"):
        bench_main(BenchConfig(what="gpu", device="cpu"))


def test_the_gpu_that_is_named_is_taken(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(gpu, "pick_device", lambda name: name)
    assert [gpu.pick_gpu(name) for name in ("auto", "cuda", "cuda:1")] == ["cuda", "cuda", "cuda:1"]


def test_a_dataset_is_for_the_gpus_training(tmp_path):
    with pytest.raises(UserError, match="--data: expected bench gpu or bench memory, found bench train"):
        bench_main(BenchConfig(what="train", device="cpu", data=tmp_path))
    with pytest.raises(UserError, match="--data: expected a dataset's folder"):
        gpu.main("cuda:0", False, tmp_path / "missing")


def test_stages_that_fail_keep_what_they_told_and_stop_no_other(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(gpu, "LEAST_SECONDS", 0.5)
    child = tmp_path / "child"
    tells = 'import json, os, sys, time, subprocess; print(json.dumps(["before", 1.5, "s"]), flush=True)\n'
    hangs = f"""
process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
open({str(child)!r}, "w").write(str(process.pid))
time.sleep(600)"""
    stages = [
        stage("talks", tells + 'print("a library\\n[1]\\n{}"); print(json.dumps(["after", 2, "ms"]))'),
        stage("raises", tells + 'raise RuntimeError("CUDA error\\nlast words")'),
        stage(
            "refuses", 'import sys; print("error: data: expected x, found y", file=sys.stderr); sys.exit(2)'
        ),
        stage("dies", tells + "os.kill(os.getpid(), 9)"),
        stage("hangs", tells + hangs, seconds=5.0),
        stage("absent", tells, lacks="gsplat is not installed"),
        stage("caches", 'import os, json; print(json.dumps([os.environ["WARP_CACHE_PATH"], 0, ""]))'),
    ]
    begin = time.monotonic()
    outcomes = {outcome.name: outcome for outcome in gpu.run_stages(stages, tmp_path, seconds=100.0)}
    assert time.monotonic() - begin < 90.0
    before = Row("before", 1.5, "s")
    assert list(outcomes) == [each.name for each in stages]
    assert outcomes["talks"].rows == [before, Row("after", 2.0, "ms")]
    assert {name: outcome.remark for name, outcome in outcomes.items()} == {
        "talks": "",
        "raises": "failed: last words",
        "refuses": "failed: data: expected x, found y",
        "dies": "failed: ended by signal 9",
        "hangs": "failed: time was up after 5 s",
        "absent": "left out: gsplat is not installed",
        "caches": "",
    }
    failed = {name for name, outcome in outcomes.items() if outcome.failed}
    assert failed == {"raises", "refuses", "dies", "hangs"}
    assert all(outcomes[name].rows == [before] for name in ("raises", "dies", "hangs"))
    assert outcomes["caches"].rows[0].what.startswith(str(tmp_path))
    # what the hanging stage had started is gone with it
    pid = int(child.read_text())
    deadline = time.monotonic() + 30.0
    while _runs(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "talks: at most 60 s"
    assert len(said) == 6


def _runs(pid):
    """Whether a process is there and no zombie."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_the_whole_time_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "LEAST_SECONDS", 0.5)
    given = []

    def words(seconds):
        given.append(seconds)
        return [sys.executable, "-c", "import time; time.sleep(600)"]

    stages = [Stage("first", 60.0, words), Stage("second", 60.0, words)]
    outcomes = [*gpu.run_stages(stages, tmp_path, seconds=1.0)]
    assert [outcome.remark for outcome in outcomes] == [
        "failed: time was up after 1 s",
        "failed: no time was left",
    ]
    assert len(given) == 1
    assert given[0] <= 1.0


def test_one_table_of_all_stages(monkeypatch, capsys):
    outcomes = [
        Outcome("raster", 3.0, [Row("blend, 3 channels", 2.0, "ms"), Row("alone", 7.0, "ms")], "", False),
        Outcome("gsplat", 4.0, [Row("blend, 3 channels", 3.0, "ms")], "", False),
        Outcome("gswarp", 0.0, [], "left out: gswarp is not installed", False),
        Outcome("tests", 9.0, [Row("passed", 311, "tests")], "failed: a | b", True),
    ]
    monkeypatch.setattr(gpu, "machine", lambda device: "some GPU")
    monkeypatch.setattr(gpu, "run_stages", lambda stages, folder, *, seconds: iter(outcomes))
    with pytest.raises(SystemExit) as end:
        gpu.main("cuda:0", False, None)
    assert end.value.code == 1
    header, _, *lines = capsys.readouterr().out.splitlines()
    assert header == "some GPU"
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert {len(row) for row in cells} == {6}
    assert cells[2:] == [
        ["**raster**", "all of it", "3.0", "s", "", ""],
        ["", "blend, 3 channels", "2", "ms", "", ""],
        ["", "alone", "7", "ms", "", ""],
        ["**gsplat**", "all of it", "4.0", "s", "", ""],
        ["", "blend, 3 channels", "3", "ms", "1.50", ""],
        ["**gswarp**", "all of it", "", "s", "", "left out: gswarp is not installed"],
        ["**tests**", "all of it", "9.0", "s", "", "failed: a / b"],
        ["", "passed", "311", "tests", "", ""],
    ]
    del outcomes[-1]  # what is left out is no failure
    gpu.main("cuda:0", True, None)
    told = json.loads(capsys.readouterr().out)
    assert told["machine"] == "some GPU"
    assert [each["name"] for each in told["stages"]] == ["raster", "gsplat", "gswarp"]
    assert told["stages"][1]["rows"][0]["over_ours"] == 1.5
    assert told["stages"][0]["rows"][0]["over_ours"] is None


def test_stages_in_their_order_and_what_they_lack(monkeypatch, tmp_path):
    monkeypatch.setattr(
        gpu, "_absent", lambda module: f"{module} is not installed" if module != "pytest" else None
    )
    stages = {each.name: each for each in gpu.stages_of("cuda:1", tmp_path)}
    assert list(stages) == list(gpu.LIMITS)
    assert next(iter(stages)) == "first use"  # into empty caches
    assert list(stages)[-1] == "tests"
    assert {name for name, each in stages.items() if each.lacks} == {"gsplat", "gswarp", "subject"}
    words = [sys.executable, "-m", "samira_warp.bench.gpu_stages", "first-use", "--device", "cuda:1"]
    words += ["--data", str(tmp_path), "--seconds", "30"]
    assert stages["second use"].words(30.0) == words
    known = set(gpu_stages.StageName.__args__)
    assert {each.words(1.0)[3] for each in stages.values()} == known
    assert all(fault(gpu_stages.StageConfig, each.words(1.0)[3:]) is None for each in stages.values())
    monkeypatch.setattr(gpu, "tests_folder", lambda: tmp_path)
    assert "no tests in" in {each.name: each for each in gpu.stages_of("cuda", None)}["tests"].lacks


@pytest.fixture
def small(monkeypatch):
    """Stages of fractions of a second, on a CPU."""
    monkeypatch.setattr(timing, "REPEATS", 1)
    monkeypatch.setattr(timing, "WARM_UP", 0)
    monkeypatch.setattr(train, "STEPS_BEFORE", 1)
    monkeypatch.setattr(gpu_stages, "PRESET", "cpu")
    monkeypatch.setattr(gpu_stages, "GAUSSIANS", 200)
    monkeypatch.setattr(gpu_stages, "SIZES", (24, 32))
    with small_preset():
        yield


def told(capsys):
    return {row[0]: row[1:] for row in map(json.loads, capsys.readouterr().out.splitlines())}


def test_rasterisers_tell_of_the_same_things(small, monkeypatch, capsys):
    gpu_stages.raster(CPU)
    ours = told(capsys)
    assert len(ours) == 2 * 2 * 5
    assert all(value > 0 and unit == "ms" for value, unit in ours.values())
    monkeypatch.setattr(
        gpu_stages, "gsplat_times", lambda disc, channels: gpu_stages.stage_times(disc, channels)
    )
    gpu_stages.gsplat(CPU)
    theirs = told(capsys)
    assert len(theirs) == 2 * 2 * 3
    assert set(theirs) < set(ours)
    times = gswarp_peer.GswarpTimes(1.0, 2.0, 0.01)
    monkeypatch.setattr(gpu_stages, "gswarp_times", lambda disc: times)
    gpu_stages.gswarp(CPU)
    theirs = told(capsys)
    assert {name for name in theirs if "difference" not in name} < set(ours)
    for name in ("gsplat", "gswarp"):
        monkeypatch.setattr(gpu_stages, f"{name}_times", lambda *_: None)
        with pytest.raises(SystemExit):
            getattr(gpu_stages, name)(CPU)


def test_frames_a_step_and_the_first_use_are_told(small, capsys):
    gpu_stages.frames(CPU)
    rows = told(capsys)
    assert {unit for _, unit in rows.values()} == {"frames/s"}
    assert {"everything moves, 24 x 24", "light moves, 32 x 32, no shadows"} < set(rows)
    gpu_stages.step(CPU)
    rows = told(capsys)
    assert {"step, backward", "step, total", "Warp launches", "synchronisations"} < set(rows)
    gpu_stages.first_use(CPU)
    (picture, _), (both, _) = told(capsys).values()
    assert 0 < picture < both


def test_a_training_of_as_many_steps_as_fit(small, monkeypatch, tiny_dataset, capsys):
    monkeypatch.setattr(train, "measure", lambda device, *, preset, shadows: {"average_ms": 20.0})
    monkeypatch.setattr(gpu_stages, "TRAINING_SECONDS", 0.07)
    gpu_stages.training(CPU, tiny_dataset)
    rows = told(capsys)
    assert rows["steps"] == [3, ""]
    seconds = rows["their time, with decoding and logging"][0]
    assert rows["steps a second"][0] == pytest.approx(3 / seconds)
    assert 5 < rows["PSNR of test frames"][0] < 40
    assert 0 < rows["SSIM of test frames"][0] < 1


class Settings(NamedTuple):
    """Those of gswarp 1.1.0."""

    image_height: int
    image_width: int
    tanfovx: float
    tanfovy: float
    bg: torch.Tensor
    scale_modifier: float
    viewmatrix: torch.Tensor
    projmatrix: torch.Tensor
    sh_degree: int
    campos: torch.Tensor
    prefiltered: bool
    auto_tune_verbose: bool = True


def test_gswarp_sees_through_the_same_camera(generator):
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    world_to_camera = torch.eye(4)
    world_to_camera[:3, :3] = turn * turn.det()
    world_to_camera[:3, 3] = torch.tensor([0.1, -0.2, 2.0])
    camera = Camera(world_to_camera, 300.0, 250.0, 32.0, 24.0, 64, 48)
    settings = Settings(**gswarp_peer.settings_of(camera))
    points = 0.3 * torch.randn(50, 3, generator=generator)
    ours = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    pixels = ours[:, :2] / ours[:, 2:] * torch.tensor([300.0, 250.0]) + torch.tensor([32.0, 24.0])
    # as diff-gaussian-rasterization has it: row vectors, and pixel centres at whole numbers
    rows = torch.cat([points, torch.ones(50, 1)], dim=1)
    torch.testing.assert_close((rows @ settings.viewmatrix)[:, :3], ours)
    clip = rows @ settings.projmatrix
    unit = clip[:, :3] / clip[:, 3:]
    theirs = ((unit[:, :2] + 1.0) * torch.tensor([64.0, 48.0]) - 1.0) / 2.0
    # float32 at some tens of pixels, through a product of matrices: 1e-6 of 64 a step, a few steps
    torch.testing.assert_close(theirs, pixels - 0.5, atol=1e-3, rtol=0.0)
    assert ((unit[:, 2] > 0.0) & (unit[:, 2] < 1.0)).all()
    at_camera = settings.campos @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    torch.testing.assert_close(at_camera, torch.zeros(3), atol=1e-6, rtol=0.0)
    # a Gaussian's size in pixels follows from these two
    assert 64 / (2 * settings.tanfovx) == pytest.approx(300.0)
    assert 48 / (2 * settings.tanfovy) == pytest.approx(250.0)


def test_gswarp_is_timed_and_its_picture_compared(monkeypatch):
    scene = make_disc(50, 40, CPU)

    class Rasterizer:
        def __init__(self, settings):
            assert (settings.image_width, settings.image_height) == (40, 40)

        def __call__(self, *, means3D, means2D, opacities, colors_precomp, scales, rotations):
            assert means2D.shape == means3D.shape == scales.shape == colors_precomp.shape == (50, 3)
            assert (opacities.shape, rotations.shape) == ((50, 1), (50, 4))
            drawn = rasterize(means3D, rotations, scales, opacities[:, 0], colors_precomp, scene.camera)
            found = type("Meta", (), {"alpha": drawn.alpha[None]})
            return 0.25 + drawn.features.permute(2, 0, 1), None, found

    module = type("gswarp", (), {"GaussianRasterizationSettings": Settings, "GaussianRasterizer": Rasterizer})
    monkeypatch.setattr(gswarp_peer, "_gswarp", lambda: module)
    times = gswarp_peer.gswarp_times(scene)
    assert times.forward > 0
    assert times.backward > 0
    assert times.difference == pytest.approx(0.25, abs=1e-6)


def test_a_gswarp_that_is_absent_or_broken_is_left_out(monkeypatch, capsys):
    scene = make_disc(50, 40, CPU)
    monkeypatch.setattr(gswarp_peer, "_gswarp", lambda: None)
    assert gswarp_peer.gswarp_times(scene) is None
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(gswarp_peer, "_gswarp", lambda: object())
    assert gswarp_peer.gswarp_times(scene) is None
    assert capsys.readouterr().err.startswith("gswarp left out: AttributeError")


def test_results_are_read_from_one_process_and_from_several():
    printed = """
tests/a.py::test_one[cuda] PASSED                                        [ 20%]
tests/a.py::test_two[a b-cuda] FAILED                                    [ 40%]
tests/a.py::test_three SKIPPED (no CUDA device on this machine)          [ 60%]
[gw1] [ 80%] PASSED tests/b.py::test_four[x y]
[gw10] [100%] ERROR tests/b.py::test_five
tests/c.py::test_that_hangs
=== 2 passed, 1 failed in 3.00s ==="""
    assert dict(gpu_stages.results_of(printed)) == {
        "tests/a.py::test_one[cuda]": "PASSED",
        "tests/a.py::test_two[a b-cuda]": "FAILED",
        "tests/a.py::test_three": "SKIPPED",
        "tests/b.py::test_four[x y]": "PASSED",
        "tests/b.py::test_five": "ERROR",
    }


TESTS_OF_A_GPU = """
import time, pytest
def test_elsewhere(): raise AssertionError
@pytest.mark.gpu
def test_good(): pass
@pytest.mark.gpu
def test_bad(): raise AssertionError
@pytest.mark.gpu
@pytest.mark.skip
def test_left_out(): pass
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """Tests of some other checkout."""
    folder = tmp_path / "checkout" / "tests"
    folder.mkdir(parents=True)
    (folder.parent / "pytest.ini").write_text("[pytest]\nmarkers = gpu\n")
    monkeypatch.setattr(gpu_stages, "tests_folder", lambda: folder)
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    return folder


def test_the_gpus_tests_are_run_and_counted(checkout, capsys):
    (checkout / "test_some.py").write_text(TESTS_OF_A_GPU)
    with pytest.raises(UserError, match=r"status is 1; tests/test_some\.py::test_bad$"):
        gpu_stages.gpu_tests(120.0)
    assert told(capsys) == {"passed": [1, "tests"], "failed": [1, "tests"], "skipped": [1, "tests"]}


def test_tests_that_hang_are_stopped_and_those_before_are_counted(checkout, monkeypatch, capsys, tmp_path):
    begun = tmp_path / "begun"
    hangs = (
        f"@pytest.mark.gpu\ndef test_hangs():\n    open({str(begun)!r}, 'w').close()\n    time.sleep(600)\n"
    )
    (checkout / "test_some.py").write_text(TESTS_OF_A_GPU.replace("AssertionError", "SystemError") + hangs)

    def ends(process, seconds, ends=gpu_stages._ends):
        while seconds == 1.0 and not begun.exists():
            time.sleep(0.02)
        return ends(process, 30.0 if begun.exists() and seconds != 1.0 else seconds)

    monkeypatch.setattr(gpu_stages, "_ends", ends)
    with pytest.raises(UserError, match="time was up after 3 tests"):
        gpu_stages.gpu_tests(1.0 + gpu_stages.ENDING_SECONDS)
    assert told(capsys)["passed"] == [1, "tests"]
    assert os.path.exists(begun)
