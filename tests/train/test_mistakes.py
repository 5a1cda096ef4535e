"""What a user can get wrong: exit status 2 and one line that names it, before the run folder is touched."""

import errno
import json
import os
import shutil
import subprocess

import numpy as np
import pytest
import torch
from data.damage import change_arrays, change_json, cut, widen, with_value
from filelock import FileLock
from subjects import STEPS, train_arguments, train_command
from warm_start import warm_python

from samira_warp import Avatar
from samira_warp.train.folder import claimed
from samira_warp.train.trainer import Trainer


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


TRAIN, FIRST = "transforms_train.json", "flame_param/00000.npz"
DAMAGES = {
    "no canonical parameters": ("canonical_flame_param.npz", os.unlink, "no such file"),
    "no list of frames": (TRAIN, os.unlink, "no such file"),
    "a list that is no JSON": (TRAIN, lambda path: path.write_text("{"), "JSON"),
    "an empty split": (
        TRAIN,
        lambda path: change_json(path, lambda d: d["frames"].clear()),
        "at least one frame",
    ),
    "no key for the image": (
        TRAIN,
        lambda path: change_json(path, lambda d: d["frames"][1].pop("file_path")),
        "file_path",
    ),
    "no key for the camera": (
        TRAIN,
        lambda path: change_json(path, lambda d: d["frames"][0].pop("transform_matrix")),
        "transform_matrix",
    ),
    "no image": ("images/00001_00.png", os.unlink, "no such file"),
    "no mask": ("fg_masks/00001_00.png", os.unlink, "no such file"),
    "an image of another size": ("images/00002_00.png", widen, "64 x 32"),
    "an albedo of another size": ("albedo/00002_00.png", widen, "64 x 32"),
    "an image that is none": ("images/00002_00.png", lambda path: path.write_text("hello"), "PNG"),
    "an image cut off in its pixels": ("images/00002_00.png", lambda path: cut(path, end=40), "whole PNG"),
    "no parameters": (FIRST, os.unlink, "no such file"),
    "no expression": (FIRST, lambda path: change_arrays(path, expr=None), "expr"),
    "too short an expression": (FIRST, lambda path: change_arrays(path, expr=lambda a: a[:, :-1]), "(1, 4)"),
    "NaN in the parameters": (FIRST, lambda path: change_arrays(path, jaw_pose=with_value(np.nan)), "finite"),
    "parameters that are no archive": (FIRST, lambda path: path.write_bytes(b"zip?"), "npz"),
    "another identity": (FIRST, lambda path: change_arrays(path, shape=lambda a: a + 1), "identity"),
    "a template without weights": ("template.npz", lambda path: change_arrays(path, weights=None), "weights"),
    "a template with NaN": (
        "template.npz",
        lambda path: change_arrays(path, v_template=with_value(np.nan)),
        "finite",
    ),
    "no template": ("template.npz", os.unlink, "--flame"),
}


def refused(capsys, *arguments):
    capsys.readouterr()
    assert train_command(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    message = captured.err.strip().splitlines()
    assert len(message) == 1, message
    assert message[0].startswith("error: ")
    return message[0]


@pytest.mark.parametrize("name", DAMAGES)
def test_a_broken_dataset_is_refused_before_anything_is_written(dataset, tmp_path, capsys, name):
    file, damage, fragment = DAMAGES[name]
    damage(dataset / file)
    message = refused(capsys, *train_arguments(dataset, tmp_path / "run"))
    assert str(dataset / file) in message
    assert fragment in message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--split", "0"),
        ("--split", "1.5"),
        ("--split", "last:0"),
        ("--split", "last:6"),
        ("--split", "half"),
        ("--max-steps", "0"),
        ("--epochs", "0"),
        ("--resolution", "0"),
        ("--resolution", "-4"),
        ("--resolution", "200000"),
        ("--gaussians", "0"),
        ("--checkpoint-every", "0"),
        ("--preview-every", "-1"),
    ],
)
def test_options_out_of_range(tiny_dataset, tmp_path, capsys, option, value):
    message = refused(capsys, *train_arguments(tiny_dataset, tmp_path / "run"), f"{option}={value}")
    assert option in message
    assert not (tmp_path / "run").exists()


def test_images_too_small_for_ssim_are_refused(tiny_dataset, tmp_path, capsys):
    message = refused(capsys, *train_arguments(tiny_dataset, tmp_path / "run"), "--resolution", "8")
    assert "--resolution 8" in message
    assert "8 x 8" in message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ([], "runs/built_in: expected a new folder"),
        (["--out", "mine"], "mine: expected a folder, found a file"),
        (["--out", "mine/run"], "mine/run: expected a folder that can be written"),
        (["--out", "done"], "done: expected a new folder, found a finished avatar"),
        (["--out", "done", "--resume"], "done/checkpoints: expected a checkpoint"),
        (["--out", "other", "--resolution", "8"], "--resolution 8"),
        (["--out", "other", "--split", "half"], "--split"),
        (["--out", "other", "--lpips-weights", "nowhere"], "nowhere"),
    ],
)
def test_the_built_in_subject_is_not_made_for_a_run_that_cannot_be(
    options, complaint, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "runs" / "built_in" / "checkpoints" / "step_000003").mkdir(parents=True)
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "done" / "avatar").mkdir(parents=True)
    assert complaint in refused(capsys, "--preset", "cpu", "--device", "cpu", "--encoder", "random", *options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["done", "mine", "runs"]
    assert [path.name for path in (tmp_path / "done").iterdir()] == ["avatar"]


def test_no_gpu(tiny_dataset, tmp_path, capsys):
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device on this machine")
    assert "CUDA" in refused(capsys, *train_arguments(tiny_dataset, tmp_path / "run"), "--device", "cuda")


def test_a_missing_head_model_is_named(dataset, tmp_path, capsys):
    (dataset / "template.npz").unlink()
    message = refused(
        capsys, *train_arguments(dataset, tmp_path / "run"), "--flame", tmp_path / "flame2023.npz"
    )
    assert str(tmp_path / "flame2023.npz") in message
    assert not (tmp_path / "run").exists()


def test_a_head_model_may_come_from_elsewhere(dataset, tmp_path):
    (dataset / "template.npz").rename(tmp_path / "flame.npz")
    arguments = train_arguments(dataset, tmp_path / "run", "--flame", tmp_path / "flame.npz")
    arguments[arguments.index(str(STEPS))] = "1"
    assert train_command(*arguments) == 0


def test_a_run_folder_that_is_a_file(tiny_dataset, tmp_path, capsys):
    (tmp_path / "run").write_text("mine")
    capsys.readouterr()
    assert train_command(*train_arguments(tiny_dataset, tmp_path / "run")) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1
    assert str(tmp_path / "run") in message[0]
    assert (tmp_path / "run").read_text() == "mine"


def test_the_process_itself_says_one_line(tmp_path):
    command = [
        *warm_python(),
        "-m",
        "samira_warp.train",
        "--data",
        str(tmp_path / "nowhere"),
        "--out",
        str(tmp_path / "run"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert str(tmp_path / "nowhere") in done.stderr
    assert not (tmp_path / "run").exists()


def film(folder):
    folder.mkdir()
    (folder / "me.MP4").write_bytes(b"film")
    return folder


NOT_DATASETS = {
    "nothing": (lambda path: path, "no such folder"),
    "a file": (lambda path: path.write_text("hello") and path, "Invalid data"),
    "a video that is none": (lambda path: film(path) / "me.MP4", "Invalid data"),
    "an empty folder": (lambda path: path.mkdir() or path, "an empty folder"),
    "a folder of videos": (film, "python -m samira_warp.prepare {data}/me.MP4 --out DIR"),
}


@pytest.mark.parametrize("name", NOT_DATASETS)
def test_what_is_no_dataset_is_said_to_be_what_it_is(tmp_path, capsys, name):
    make, found = NOT_DATASETS[name]
    data = make(tmp_path / "data")
    message = refused(capsys, *train_arguments(data, tmp_path / "run"))
    assert message.startswith(f"error: {data}: expected ")
    assert found.format(data=data) in message.partition(", found ")[2]
    assert "--flame" not in message
    assert not (tmp_path / "run").exists()


def test_two_trainings_do_not_share_a_folder(tiny_dataset, tmp_path, capsys):
    with claimed(tmp_path / "run"):
        message = refused(capsys, *train_arguments(tiny_dataset, tmp_path / "run"))
        expected = "expected a folder that no other training uses, found one at work in it"
        assert message == f"error: {tmp_path / 'run'}: {expected}"
    # nothing was written, so nothing is left
    assert not (tmp_path / "run").exists()


def test_a_training_keeps_others_out_from_its_beginning_to_its_end(
    tiny_dataset, tmp_path, capsys, monkeypatch
):
    run, refusals = tmp_path / "run", []
    step = Trainer.train_step

    def other_training(self):
        monkeypatch.setattr(Trainer, "train_step", step)
        refusals.append(train_command(*train_arguments(tiny_dataset, run), "--resume"))
        return step(self)

    monkeypatch.setattr(Trainer, "train_step", other_training)
    assert train_command(*train_arguments(tiny_dataset, run)) == 0
    assert refusals == [2]
    assert f"{run}: expected a folder that no other training uses" in capsys.readouterr().err
    assert not (run / ".lock").exists()


@pytest.mark.parametrize(
    "error", [NotImplementedError("no flock"), OSError(errno.ENOLCK, "No locks available")]
)
def test_where_there_are_no_locks_training_goes_on_and_says_so(
    tiny_dataset, tmp_path, capsys, monkeypatch, error
):
    def acquire(*arguments, **options):
        raise error

    monkeypatch.setattr(FileLock, "acquire", acquire)
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    arguments[arguments.index(str(STEPS))] = "1"
    assert train_command(*arguments) == 0
    assert f"{tmp_path / 'run'}: no locks there" in capsys.readouterr().err


def test_a_run_folder_that_cannot_be_written_is_named_before_the_dataset_is_read(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    run = tmp_path / "file" / "run"
    message = refused(capsys, *train_arguments(tmp_path / "nowhere", run))
    assert message.startswith(f"error: {run}: expected a folder that can be written, found ")


def test_a_finished_avatar_without_its_checkpoints_is_not_overwritten(
    tiny_run, tiny_dataset, tmp_path, capsys
):
    run = shutil.copytree(tiny_run, tmp_path / "run")
    shutil.rmtree(run / "checkpoints")
    before = (run / "avatar" / "avatar.safetensors").read_bytes()
    assert f"{run}: expected a new folder, found a finished avatar" in refused(
        capsys, *train_arguments(tiny_dataset, run)
    )
    assert f"{run / 'checkpoints'}: expected a checkpoint" in refused(
        capsys, *train_arguments(tiny_dataset, run, "--resume")
    )
    assert (run / "avatar" / "avatar.safetensors").read_bytes() == before


def late_frame():
    """A training frame that is neither the reference nor among the first three steps' frames."""
    order = torch.randperm(4, generator=torch.Generator().manual_seed(42 * 1_000_003)).tolist()
    return order[3], order[2]


def test_a_broken_image_in_the_stream_ends_the_run_with_the_last_checkpoint_whole(
    dataset, tiny_run, tmp_path, capsys
):
    reference = json.loads((tiny_run / "config.json").read_text())["reference_frame"]
    last, before = (f"{index:05d}_00" for index in late_frame())
    name = before if last == reference else last
    # without an albedo of its own the frame is not decoded before its step
    (dataset / "albedo" / f"{name}.png").unlink()
    path = dataset / "images" / f"{name}.png"
    whole = path.read_bytes()
    cut(path)
    arguments = train_arguments(dataset, tmp_path / "run", "--checkpoint-every", 1)
    capsys.readouterr()
    assert train_command(*arguments) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    errors = [line for line in message.splitlines() if line.startswith("error: ")]
    assert errors == [message.strip().splitlines()[-1]]
    assert str(path) in errors[0]
    done = 2 if name == before else 3
    kept = sorted(folder.name for folder in (tmp_path / "run" / "checkpoints").iterdir())
    assert kept[-1] == f"step_{done:06d}"
    Avatar.load(tmp_path / "run" / "checkpoints" / kept[-1])
    assert not (tmp_path / "run" / "avatar").exists()
    path.write_bytes(whole)
    assert train_command(*arguments, "--resume") == 0


def test_a_broken_test_image_is_named_and_the_avatar_is_kept(dataset, tmp_path, capsys):
    cut(dataset / "images" / "00005_00.png")
    assert train_command(*train_arguments(dataset, tmp_path / "run")) == 2
    assert str(dataset / "images" / "00005_00.png") in capsys.readouterr().err.strip().splitlines()[-1]
    Avatar.load(tmp_path / "run" / "avatar")


@pytest.mark.parametrize("count", [1, 4])
def test_albedo_of_frames_without_a_matte_is_said_to_be_unused(dataset, tmp_path, capfd, count):
    change_json(dataset / TRAIN, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"][:count]])
    assert train_command(*train_arguments(dataset, tmp_path / "run")) == 0
    said = capfd.readouterr().err
    first = dataset / "albedo" / "00000_00.png"
    assert said.count(f"{count} of 4 albedo files are not compared with, the first is {first}: ") == 1
    assert ("no pseudo-albedo" in said) == (count == 4)


def test_albedo_that_nobody_compares_with_is_not_missed(dataset, tmp_path, capfd):
    change_json(dataset / TRAIN, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"]])
    assert train_command(*train_arguments(dataset, tmp_path / "run", "--ablate", "no-albedo")) == 0
    said = capfd.readouterr().err
    assert "pseudo-albedo" not in said
    assert "albedo files" not in said
