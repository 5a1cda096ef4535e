"""Runs that end early, by a signal or a full disk, and go on."""

import contextlib
import json
import shutil
import signal
import subprocess
import sys

import pytest
import torch
from data.damage import change_arrays, file_size_limit
from data.tiny import make_tiny_dataset
from safetensors.torch import load_file, save_file
from subjects import TESTS, train_arguments, train_command, write_lpips_weights

from samira_warp import Avatar
from samira_warp.train import trainer

ENDED = """
import os, signal, sys
sys.path.insert(0, {tests!r})
import subjects
from samira_warp.train import checkpoint, trainer

step, write = trainer.Trainer.train_step, checkpoint.save_tensors

def send():
    os.kill(os.getpid(), signal.{signal})

def ended_step(self):
    if self.step == 4 and {in_step}:
        send()
    return step(self)

def ended_write(tensors, path):
    # the avatar's tensors of the second checkpoint are on the disk, training's are not
    if "step_000006" in str(path) and not {in_step}:
        send()
    write(tensors, path)

trainer.Trainer.train_step, checkpoint.save_tensors = ended_step, ended_write
sys.exit(subjects.train_command(*sys.argv[1:]))
"""


def end_by(name, arguments, *, in_step=True):
    """Run the train verb in a process that gets a signal: in its fifth step, or while it writes its second
    checkpoint."""
    script = ENDED.format(tests=str(TESTS), signal=name, in_step=in_step)
    return subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, timeout=300, check=False
    )


def same_bits(first, second):
    return (first / "avatar" / "avatar.safetensors").read_bytes() == (
        second / "avatar" / "avatar.safetensors"
    ).read_bytes()


def checkpoints(folder):
    return sorted(path.name for path in (folder / "checkpoints").iterdir() if not path.name.startswith("."))


@pytest.mark.parametrize("in_step", [True, False], ids=["in a step", "in a checkpoint"])
def test_a_killed_run_goes_on_to_the_same_bits(tiny_run, tiny_dataset, tmp_path, in_step):
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    assert end_by("SIGKILL", arguments, in_step=in_step).returncode == -signal.SIGKILL
    assert checkpoints(tmp_path / "run") == ["step_000003"]
    assert not (tmp_path / "run" / "avatar").exists()
    assert train_command(*arguments, "--resume") == 0
    assert same_bits(tiny_run, tmp_path / "run")
    results = [json.loads((folder / "results.json").read_text()) for folder in (tiny_run, tmp_path / "run")]
    assert results[0] == results[1]
    # what the killed process left half written does not stay
    assert not [path for path in (tmp_path / "run").rglob("*") if path.name.startswith(".")]


def test_ctrl_c_saves_a_checkpoint_says_how_to_go_on_and_exits_130(tiny_run, tiny_dataset, tmp_path):
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    ended = end_by("SIGINT", arguments)
    assert ended.returncode == 130
    assert "Traceback" not in ended.stderr
    last = ended.stderr.strip().splitlines()[-1]
    assert "step 5 of 6" in last
    assert "--resume" in last
    assert checkpoints(tmp_path / "run") == ["step_000003", "step_000005"]
    assert train_command(*arguments, "--resume") == 0
    assert same_bits(tiny_run, tmp_path / "run")
    steps = [
        json.loads(line)["step"] for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    ]
    assert steps == sorted(set(steps))


def test_a_finished_run_can_be_resumed_without_a_change(tiny_run, tiny_dataset, tmp_path):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    before = (folder / "avatar" / "avatar.safetensors").read_bytes()
    assert train_command(*train_arguments(tiny_dataset, folder), "--resume") == 0
    assert (folder / "avatar" / "avatar.safetensors").read_bytes() == before


def refused(capsys, *arguments):
    capsys.readouterr()
    assert train_command(*arguments) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1, message
    return message[0]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--seed", "7"),
        ("--max-steps", "9"),
        ("--resolution", "16"),
        ("--split", "0.5"),
        ("--ablate", "no-mask"),
    ],
)
def test_resuming_with_other_settings_is_refused(tiny_run, tiny_dataset, tmp_path, capsys, option, value):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    message = refused(capsys, *train_arguments(tiny_dataset, folder), option, value, "--resume")
    assert option in message
    assert value in message


def other_parameters(folder):
    for path in folder.glob("flame_param/*.npz"):
        change_arrays(path, expr=lambda values: 0.5 * values)


OTHER_DATA = {
    "more frames": lambda folder: make_tiny_dataset(folder, frames=8),
    "as many frames of another performance": lambda folder: other_parameters(make_tiny_dataset(folder)),
}


@pytest.mark.parametrize("name", OTHER_DATA)
def test_resuming_on_other_data_is_refused(tiny_run, tmp_path, capsys, name):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    OTHER_DATA[name](tmp_path / "subject")
    message = refused(capsys, *train_arguments(tmp_path / "subject", folder), "--resume")
    assert str(folder) in message
    assert "as the run was begun" in message


def test_the_same_data_may_have_moved_and_the_record_stays(tiny_run, tiny_dataset, tmp_path):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    moved = shutil.copytree(tiny_dataset, tmp_path / "elsewhere")
    before = (folder / "config.json").read_bytes()
    threads = torch.get_num_threads()
    torch.set_num_threads(threads + 1)
    try:
        assert train_command(*train_arguments(moved, folder), "--resume") == 0
    finally:
        torch.set_num_threads(threads)
    assert (folder / "config.json").read_bytes() == before


def test_resuming_with_or_without_lpips_where_it_was_the_other_way_is_refused(
    tiny_run, tiny_dataset, tmp_path, capsys
):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    weights = tmp_path / "weights"
    if json.loads((folder / "config.json").read_text())["perceptual"]:
        weights.mkdir()
    else:
        write_lpips_weights(weights, "alex")
    message = refused(capsys, *train_arguments(tiny_dataset, folder), "--lpips-weights", weights, "--resume")
    assert "perceptual" in message


@pytest.mark.parametrize("key", ["settings", "encoder", "train_frames", "template_hash"])
@pytest.mark.parametrize("value", [None, [], "absent"])
def test_a_damaged_record_is_refused(tiny_run, tiny_dataset, tmp_path, capsys, key, value):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    record = json.loads((folder / "config.json").read_text())
    if value == "absent":
        del record[key]
    else:
        record[key] = value
    (folder / "config.json").write_text(json.dumps(record))
    message = refused(capsys, *train_arguments(tiny_dataset, folder), "--resume")
    assert str(folder) in message
    assert key in message


def test_a_checkpoint_without_some_of_trainings_tensors_is_named(tiny_run, tiny_dataset, tmp_path, capsys):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    path = folder / "checkpoints" / "step_000006" / "training.safetensors"
    whole = load_file(path)
    for name in ("tracked.expression", "density.views"):
        save_file({key: value for key, value in whole.items() if key != name}, path)
        message = refused(capsys, *train_arguments(tiny_dataset, folder), "--resume")
        assert str(path) in message
        assert name.split(".")[1] in message


def test_a_run_is_not_overwritten(tiny_run, tiny_dataset, capsys):
    message = refused(capsys, *train_arguments(tiny_dataset, tiny_run))
    assert str(tiny_run) in message
    assert "--resume" in message


def test_nothing_to_resume(tiny_dataset, tmp_path, capsys):
    message = refused(capsys, *train_arguments(tiny_dataset, tmp_path / "run"), "--resume")
    assert str(tmp_path / "run" / "checkpoints") in message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["training.safetensors", "avatar.safetensors"])
def test_a_broken_checkpoint_is_named(tiny_run, tiny_dataset, tmp_path, capsys, name):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    path = folder / "checkpoints" / "step_000006" / name
    path.write_bytes(path.read_bytes()[:1000])
    assert str(path) in refused(capsys, *train_arguments(tiny_dataset, folder), "--resume")


@pytest.mark.parametrize("file", ["avatar.safetensors", "training.safetensors"])
def test_a_full_disk_leaves_the_last_checkpoint_whole(
    tiny_run, tiny_dataset, tmp_path, monkeypatch, capsys, file
):
    save = trainer.save_checkpoint
    # just too small for the file, and large enough for what is written before it
    limit = (tiny_run / "checkpoints" / "step_000006" / file).stat().st_size - 1000

    def save_on_a_full_disk(folder, state, *, record):
        with file_size_limit(limit) if state.step == 6 else contextlib.nullcontext():
            return save(folder, state, record=record)

    monkeypatch.setattr(trainer, "save_checkpoint", save_on_a_full_disk)
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    capsys.readouterr()
    assert train_command(*arguments) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    last = message.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert file in last
    assert sorted(path.name for path in (tmp_path / "run" / "checkpoints").iterdir()) == ["step_000003"]
    Avatar.load(tmp_path / "run" / "checkpoints" / "step_000003")
    load_file(tmp_path / "run" / "checkpoints" / "step_000003" / "training.safetensors")
    monkeypatch.setattr(trainer, "save_checkpoint", save)
    assert train_command(*arguments, "--resume") == 0
    assert same_bits(tiny_run, tmp_path / "run")
