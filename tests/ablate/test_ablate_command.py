"""``python -m samira_warp.ablate`` from its options to its tables."""

import contextlib
import io
import json
import shutil
import subprocess

import numpy as np
import pytest
from data.damage import change_json, cut
from PIL import Image
from subjects import TESTS, small_preset
from warm_start import warm_python

from samira_warp.ablate.__main__ import command
from samira_warp.io.images import read_image, write_png
from samira_warp.train.folder import claimed

STEPS = 3
VARIANTS = ("full", "no-residual")
RUNS = ["full_42", "no-residual_42", "full_43", "no-residual_43"]
NAMES = {0: "none", 1: "eye", 2: "mouth"}

PROCESS = """
import os, signal, sys
sys.path.insert(0, {tests!r})
import subjects
from samira_warp.ablate.__main__ import command
from samira_warp.train import trainer

step = trainer.Trainer.train_step

def interrupted(self):
    if (self.settings.out.name, self.step) == ({run!r}, 1):
        os.kill(os.getpid(), signal.SIGINT)
    return step(self)

trainer.Trainer.train_step = interrupted
with subjects.small_preset():
    sys.exit(command(sys.argv[1:]))
"""


def arguments(data, out, *more, steps=STEPS):
    words = ["--data", data, "--out", out, "--preset", "cpu", "--device", "cpu", "--encoder", "random"]
    return [*map(str, words), "--max-steps", str(steps), *map(str, more)]


def in_a_process(*words, interrupted_in):
    """The verb in a process of its own, with the small preset; Ctrl-C comes in a run's second step."""
    script = PROCESS.format(tests=str(TESTS), run=interrupted_in)
    return subprocess.run(
        [*warm_python(), "-c", script, *words], capture_output=True, text=True, timeout=300, check=False
    )


def in_this_process(*words):
    with small_preset():
        return command(words)


@pytest.fixture(scope="module")
def no_weights(tmp_path_factory):
    """What this machine has in its caches is no part of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCH_HOME", str(tmp_path_factory.mktemp("hub")))
        yield


@pytest.fixture(scope="module")
def dataset(tiny_dataset, tmp_path_factory):
    """The tiny subject with labels: an eye in the upper left quarter, a mouth in the lower half."""
    folder = shutil.copytree(tiny_dataset, tmp_path_factory.mktemp("labelled") / "subject")
    (folder / "gt" / "parse").mkdir(parents=True)
    labels = np.zeros((32, 32), np.uint8)
    labels[:16, :16], labels[16:] = 1, 2
    for name in ("00004_00", "00005_00"):
        write_png(folder / "gt" / "parse" / f"{name}.png", labels)
    (folder / "gt" / "parse.json").write_text(json.dumps(NAMES))
    return folder


@pytest.fixture(scope="module")
def study(dataset, no_weights, tmp_path_factory):
    """A comparison of two variants and two seeds that was interrupted in its second run and gone on with.

    Its options, its folder, what the first call said, the checkpoints after it, and what the second one said
    on standard output and error.
    """
    out = tmp_path_factory.mktemp("study") / "out"
    words = arguments(dataset, out, "--variants", "no-residual", "--seeds", 2)
    first = in_a_process(*words, interrupted_in="no-residual_42")
    halfway = sorted(path.relative_to(out).as_posix() for path in out.glob("*/checkpoints/*"))
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()) as told:
        assert in_this_process(*words) == 0, told.getvalue()
    return words, out, first, halfway, (said.getvalue(), told.getvalue())


def written(out):
    """Times of all files of the runs and tables."""
    return {path.relative_to(out): path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}


def test_ctrl_c_ends_with_the_shells_status_and_the_same_command_goes_on(study):
    _, out, first, halfway, (_, told) = study
    assert first.returncode == 130, first.stderr
    assert first.stdout == ""
    assert "Traceback" not in first.stderr
    assert first.stderr.strip().splitlines()[-1] == "stopped at step 2 of 3; go on with the same command"
    assert halfway == ["full_42/checkpoints/step_000003", "no-residual_42/checkpoints/step_000002"]
    said = [line.partition(": ")[2] for line in told.splitlines() if line.startswith("run ")]
    assert said == [
        f"full, seed 42, is there: {out / 'full_42'}",
        f"no-residual, seed 42, begins: {out / 'no-residual_42'}",
        f"full, seed 43, begins: {out / 'full_43'}",
        f"no-residual, seed 43, begins: {out / 'no-residual_43'}",
    ]
    steps = [
        json.loads(line)["step"]
        for line in (out / "no-residual_42" / "metrics.jsonl").read_text().splitlines()
    ]
    assert steps == [STEPS]
    checkpoints = sorted(path.name for path in (out / "no-residual_42" / "checkpoints").iterdir())
    assert checkpoints == ["step_000002", "step_000003"]


def test_what_is_written_agrees(study):
    _, out, _, _, (said, _) = study
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [*RUNS, "ablation.json", "ablation.md", "regions.png"]
    )
    assert said == (out / "ablation.md").read_text()
    written = json.loads((out / "ablation.json").read_text())
    assert [run["folder"] for run in written["runs"]] == RUNS
    assert (written["steps"], written["seeds"], written["encoder"]) == (STEPS, [42, 43], "random")
    assert written["settings"]["resolution"] == 32
    full, other = (
        [run["scores"] for run in written["runs"] if run["variant"] == variant] for variant in VARIANTS
    )
    said = written["variants"]["no-residual"]
    for values, of in (
        ([scores["psnr"] for scores in other], said["scores"]["psnr"]),
        (
            [scores["regions"]["mouth"]["ssim"] for scores in other],
            said["scores"]["regions"]["mouth"]["ssim"],
        ),
    ):
        assert of["mean"] == pytest.approx(np.mean(values), rel=1e-12)
        assert of["spread"] == pytest.approx(np.std(values, ddof=1), rel=1e-9)
    difference = said["differences"]["regions"]["eye"]["psnr"]
    eyes = [[scores["regions"]["eye"]["psnr"] for scores in of] for of in (other, full)]
    assert difference["mean"] == pytest.approx(np.mean(eyes[0]) - np.mean(eyes[1]), rel=1e-9)
    spread = np.sqrt(np.var(eyes[0], ddof=1) + np.var(eyes[1], ddof=1))
    assert difference["spread"] == pytest.approx(spread, rel=1e-9)
    assert difference["within_spread"] is bool(abs(difference["mean"]) <= spread)
    with Image.open(out / "regions.png") as picture:
        assert picture.width > 400
    assert len(np.unique(read_image(out / "regions.png", channels=3).reshape(-1, 3), axis=0)) > 4


def test_scores_by_region_are_those_of_the_verbs(study, dataset, tmp_path, capsys):
    """Whole frames as training scored them; regions as render and evaluate --regions have them."""
    from samira_warp.__main__ import main

    _, out, _, _, _ = study
    for name in RUNS:
        scores, results = (
            json.loads((out / name / f"{file}.json").read_text()) for file in ("scores", "results")
        )
        assert {key: scores[key] for key in ("psnr", "ssim", "l1", "psnr_foreground", "lpips")} == {
            key: results[key] for key in ("psnr", "ssim", "l1", "psnr_foreground", "lpips")
        }
    pictures = ["--avatar", str(out / "full_43"), "--out", str(tmp_path / "pictures"), "--device", "cpu"]
    assert main(["render", *pictures]) == 0
    capsys.readouterr()
    labels = ["--regions", str(dataset / "gt" / "parse")]
    assert main(["evaluate", "--pred", str(tmp_path / "pictures"), "--data", str(dataset), *labels]) == 0
    theirs = json.loads(capsys.readouterr().out)["regions"]
    ours = json.loads((out / "full_43" / "scores.json").read_text())["regions"]
    assert ours.keys() == theirs.keys() == set(NAMES.values())
    for region in ours:
        # the truth here is that of the cache, rounded to 16 bits: PSNR near 20 dB moves by less than 1e-3
        assert ours[region]["psnr"] == pytest.approx(theirs[region]["psnr"], abs=1e-3)


def test_a_finished_comparison_trains_nothing_again(study, capsys):
    words, out, _, _, _ = study
    before = written(out)
    assert in_this_process(*words) == 0
    said = capsys.readouterr()
    assert said.err.count("is there") == len(RUNS)
    assert said.out == (out / "ablation.md").read_text()
    after = written(out)
    assert after.keys() == before.keys()
    changed = {str(path) for path in after if after[path] != before[path]}
    assert changed == {"ablation.json", "ablation.md", "regions.png"}


def test_checkpoints_of_finished_runs_may_go(study, tmp_path):
    words, out, _, _, _ = study
    copy = shutil.copytree(out, tmp_path / "copy")
    for folder in copy.glob("*/checkpoints"):
        shutil.rmtree(folder)
    words = [str(copy) if word == str(out) else word for word in words]
    assert in_this_process(*words) == 0


def test_one_seed_says_that_the_spread_is_not_known(study, tmp_path, capsys):
    words, out, _, _, _ = study
    copy = shutil.copytree(out, tmp_path / "copy")
    words = [str(copy) if word == str(out) else word for word in words]
    assert in_this_process(*words, "--seeds", "1") == 0
    text = capsys.readouterr().out
    assert "One seed: the spread over seeds is not known" in text
    assert "±" not in text
    assert "difference from full" in text
    variants = json.loads((copy / "ablation.json").read_text())["variants"]
    assert variants["full"]["scores"]["psnr"]["spread"] is None
    assert variants["no-residual"]["differences"]["psnr"]["within_spread"] is None
    # of the full method alone there are no differences, and no picture of them
    assert in_this_process(*words, "--seeds", "2", "--variants", "full") == 0
    assert "difference from full" not in capsys.readouterr().out
    assert not (copy / "regions.png").exists()


def refused(capsys, *words):
    capsys.readouterr()
    with contextlib.suppress(SystemExit):  # what tyro refuses ends the process
        assert in_this_process(*words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("error: ")
    return line


def test_runs_with_other_settings_are_refused_before_anything_is_trained(study, tmp_path, capsys):
    words, out, _, _, _ = study
    before = written(out)
    steps = [str(STEPS + 1) if word == str(STEPS) else word for word in words]
    assert f"{out / 'full_42'}: steps: expected 3 as the run was begun, found 4" in refused(capsys, *steps)
    line = refused(capsys, *words, "--variants", "no-routing", "--split", "last:1")
    assert f"{out / 'full_42'}: --split: expected dataset as the run was begun, found last:1" in line
    assert written(out) == before
    copy = shutil.copytree(out, tmp_path / "copy")
    words = [str(copy) if word == str(out) else word for word in words]
    change_json(copy / "no-residual_43" / "config.json", lambda record: record.update(encoder="another"))
    line = refused_at_the_end(capsys, *words)
    assert f"{copy / 'no-residual_43'}: encoder: expected random as in {copy / 'full_42'}" in line


def refused_at_the_end(capsys, *words):
    capsys.readouterr()
    assert in_this_process(*words) == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_a_run_that_fails_ends_with_its_message_and_leaves_the_tables(study, tmp_path, capsys):
    words, out, _, _, _ = study
    copy = shutil.copytree(out, tmp_path / "copy")
    words = [str(copy) if word == str(out) else word for word in words]
    (copy / "no-residual_43" / "results.json").unlink()
    before = written(copy)
    with claimed(copy / "no-residual_43"):
        line = refused_at_the_end(capsys, *words)
    expected = "expected a folder that no other training uses, found one at work in it"
    assert line == f"error: {copy / 'no-residual_43'}: {expected}"
    assert written(copy) == before


def test_a_broken_dataset_is_refused_before_anything_is_written(dataset, tmp_path, capsys):
    copy = shutil.copytree(dataset, tmp_path / "subject")
    cut(copy / "images" / "00002_00.png", end=40)
    assert "00002_00.png" in refused(capsys, *arguments(copy, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        (["--seeds", "0"], "--seeds: expected a positive number, found 0"),
        (["--max-steps", "0"], "--max-steps: expected a positive number, found 0"),
        (["--variants", "no-head"], "no-head"),
        (["--data", "{tmp}/none"], "none: expected a dataset's folder, found no such folder"),
        (["--out", "{tmp}/file"], "file: expected a folder, found a file"),
        (["--regions", "{tmp}/none"], "none: expected a folder of label images, found no such folder"),
        (["--regions", "{tmp}"], "parse.json: expected the names of the labels"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_two(dataset, tmp_path, capsys, more, fragment):
    (tmp_path / "file").write_text("mine")
    line = refused(
        capsys, *arguments(dataset, tmp_path / "out"), *(word.format(tmp=tmp_path) for word in more)
    )
    assert fragment in line
    assert not (tmp_path / "out").exists()


def test_labels_of_every_test_frame_are_needed(dataset, tmp_path, capsys):
    copy = shutil.copytree(dataset, tmp_path / "subject")
    (copy / "gt" / "parse" / "00005_00.png").unlink()
    line = refused(capsys, *arguments(copy, tmp_path / "out"))
    assert "00005_00.png: expected the frame's region labels, found no such file" in line


def test_a_dataset_without_labels_is_scored_without_regions(study, tiny_dataset, tmp_path, capsys):
    """The frames are the same, so that the runs are, too."""
    words, out, _, _, _ = study
    copy = shutil.copytree(out, tmp_path / "copy")
    words = arguments(tiny_dataset, copy, "--variants", "no-residual")
    assert in_this_process(*words) == 0
    text = capsys.readouterr().out
    assert "No regions: the dataset has no labels (--regions DIR)." in text
    assert "by region" not in text
    assert "regions" not in json.loads((copy / "ablation.json").read_text())["variants"]["full"]["scores"]


def test_the_command_itself(tmp_path):
    absent, out = str(tmp_path / "none"), str(tmp_path / "out")
    done = subprocess.run(
        [*warm_python(), "-m", "samira_warp.ablate", "--data", absent, "--out", out],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == f"error: {absent}: expected a dataset's folder, found no such folder\n"
