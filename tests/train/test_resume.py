"""Runs that end early, by a signal or a full disk, and go on."""

import contextlib
import json
import shutil
import signal
import subprocess

import pytest
import torch
from data.damage import change_arrays, change_json, file_size_limit
from data.tiny import make_tiny_dataset
from safetensors.torch import load_file, save_file
from subjects import SMALL, TESTS, train_arguments, train_command, write_lpips_weights
from warm_start import warm_python

from samira_warp import Avatar
from samira_warp.train import trainer
from samira_warp.train.config import PRESETS
from samira_warp.train.interrupt import STILL_SAVING, STOPPING

ENDED = """
import os, signal, sys, time
sys.path.insert(0, {tests!r})
import subjects
from samira_warp.train import checkpoint, trainer

step, write = trainer.Trainer.train_step, checkpoint.save_tensors

def send():
    for _ in range({times}):
        os.kill(os.getpid(), signal.{signal})
        time.sleep(0.5)  # to be told of, one by one

def ended_step(self):
    if self.step == {at} and {in_step}:
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


AT_ONCE = """
import hashlib, os, signal, sys, threading
sys.path.insert(0, {tests!r})
import subjects
from samira_warp.train import trainer

step = trainer.Trainer.train_step

def slow_step(self):
    if self.step == 4:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        threading.Timer(1.5, os.write, (2, b"the call goes on")).start()
        hashlib.pbkdf2_hmac("sha256", b"", b"", 8_000_000)  # seconds in one call
        os.write(2, b"the call ends")
    return step(self)

trainer.Trainer.train_step = slow_step
sys.exit(subjects.train_command(*sys.argv[1:]))
"""


def end_by(name, arguments, *, in_step=True, at=4, times=1):
    """Run the train verb in a process that gets a signal: after so many steps (the fifth, without more), or
    while it writes its second checkpoint."""
    script = ENDED.format(tests=str(TESTS), signal=name, in_step=in_step, at=at, times=times)
    return subprocess.run(
        [*warm_python(), "-c", script, *arguments], capture_output=True, text=True, timeout=300, check=False
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
    assert ended.stderr.count(STOPPING) == 1
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


def test_ctrl_c_is_answered_at_once(tiny_dataset, tmp_path):
    """Even where the main thread is in one long call, as for the compilation of a kernel."""
    script = AT_ONCE.format(tests=str(TESTS))
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    ended = subprocess.run(
        [*warm_python(), "-c", script, *arguments], capture_output=True, text=True, timeout=300, check=False
    )
    assert ended.returncode == 130
    said = [
        ended.stderr.index(words) for words in (STOPPING, "the call goes on", "the call ends", "step 5 of 6")
    ]
    assert said == sorted(said)


def test_a_second_ctrl_c_loses_nothing_and_says_what_a_third_would(tiny_dataset, tmp_path):
    ended = end_by("SIGINT", train_arguments(tiny_dataset, tmp_path / "run"), times=2)
    assert ended.returncode == 130
    assert ended.stderr.index(STOPPING) < ended.stderr.index(STILL_SAVING)
    assert "stopped at step 5 of 6" in ended.stderr
    assert checkpoints(tmp_path / "run") == ["step_000003", "step_000005"]


def test_a_third_ctrl_c_gives_up_what_is_not_saved_and_says_so(tiny_run, tiny_dataset, tmp_path):
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    ended = end_by("SIGINT", arguments, times=3)
    assert ended.returncode == 130
    assert "Traceback" not in ended.stderr
    last = ended.stderr.strip().splitlines()[-1]
    assert "given up at step 4 of 6, last saved at 3" in last
    assert "--resume" in last
    assert checkpoints(tmp_path / "run") == ["step_000003"]
    assert train_command(*arguments, "--resume") == 0
    assert same_bits(tiny_run, tmp_path / "run")


def test_sigterm_saves_a_checkpoint_too(tiny_dataset, tmp_path):
    ended = end_by("SIGTERM", train_arguments(tiny_dataset, tmp_path / "run"), times=4)
    assert ended.returncode == 130
    assert ended.stderr.count(STOPPING) == 1
    assert checkpoints(tmp_path / "run") == ["step_000003", "step_000005"]


def test_ctrl_c_while_the_avatar_is_scored_says_where_it_is(
    tiny_run, tiny_dataset, tmp_path, monkeypatch, capsys
):
    from samira_warp.train import run as run_module

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "score", interrupted)
        assert train_command(*arguments) == 130
    assert f"the avatar is in {tmp_path / 'run' / 'avatar'}, not yet scored" in capsys.readouterr().err
    assert train_command(*arguments, "--resume") == 0
    assert (tmp_path / "run" / "results.json").read_bytes() == (tiny_run / "results.json").read_bytes()


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
        ("--max-steps", "5"),
        ("--epochs", "1"),
        ("--preset", "paper"),
        ("--resolution", "16"),
        ("--split", "0.5"),
        ("--ablate", "no-mask"),
    ],
)
def test_resuming_with_other_settings_is_refused(tiny_run, tiny_dataset, tmp_path, capsys, option, value):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    message = refused(capsys, *train_arguments(tiny_dataset, folder), option, value, "--resume")
    assert f"{folder}: {option}: expected " in message
    assert "as the run was begun" in message


def test_what_is_not_asked_for_is_as_the_run_was_begun(tiny_dataset, tmp_path, monkeypatch):
    """No option but --resume and the folder is needed, and none has its default."""
    monkeypatch.chdir(tmp_path)
    options = (
        "--seed",
        7,
        "--split",
        "0.5",
        "--ablate",
        "no-mask",
        "no-albedo",
        "--tie-light",
        "--gaussians",
        280,
    )
    assert train_command(*train_arguments(tiny_dataset, "run", *options)) == 0
    record = (tmp_path / "run" / "config.json").read_bytes()
    scores = (tmp_path / "run" / "results.json").read_bytes()
    again = shutil.copytree(tmp_path / "run", tmp_path / "again")
    for name in ("training.json", "training.safetensors"):
        (again / "checkpoints" / "step_000006" / name).unlink()
    monkeypatch.chdir(again)
    assert train_command("--out", again, "--resume") == 0
    assert (again / "config.json").read_bytes() == record
    assert (again / "results.json").read_bytes() == scores
    assert same_bits(tmp_path / "run", again)


@pytest.mark.parametrize("option", [("--seed", "42"), ("--no-tie-light",), ("--ablate",)])
def test_asking_for_a_default_that_the_run_does_not_have_is_refused(tiny_run, tmp_path, capsys, option):
    """An option that is asked for is told from one that is not, whatever its value."""
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    change_json(
        folder / "config.json",
        lambda record: record["settings"].update(seed=7, tie_light=True, ablate=["no-mask"]),
    )
    message = refused(capsys, "--out", folder, "--resume", *option)
    assert f"{folder}: {option[0].replace('--no-', '--')}: expected " in message


def test_the_device_may_change_and_the_preset_stays(tiny_run, tmp_path, capsys, monkeypatch):
    """Begun where there is a GPU, with that machine's preset; gone on with where there is none."""
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    change_json(
        folder / "config.json", lambda record: record["settings"].update(device="cuda", preset="paper")
    )
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setitem(PRESETS, "paper", SMALL)
    assert train_command("--out", folder, "--resume") == 0
    assert "begun on cuda, now on cpu: the bits will differ" in capsys.readouterr().err
    settings = json.loads((folder / "config.json").read_text())["settings"]
    assert (settings["preset"], settings["device"]) == ("paper", "cuda")


def test_a_device_that_is_asked_for_is_taken(tiny_run, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert "--device cuda" in refused(capsys, "--out", folder, "--resume", "--device", "cuda")


def test_a_run_of_an_older_version_goes_on(tiny_run, tmp_path):
    """Its config.json has settings that are none any more, and lacks what came later."""
    folder = shutil.copytree(tiny_run, tmp_path / "run")

    def older(record):
        record["settings"].update(resume=False, gone=3)
        del record["settings"]["tie_light"], record["earlier_lengths"]

    change_json(folder / "config.json", older)
    assert train_command("--out", folder, "--resume") == 0
    assert same_bits(tiny_run, folder)


def metrics(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


LONGER = {"--max-steps": (11, 11), "--epochs": (3, 12)}
"""Options that extend a run of six steps, four to the epoch, and the steps it then has."""


@pytest.mark.parametrize("option", LONGER)
def test_a_finished_run_is_extended(tiny_run, tmp_path, capsys, option):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    value, steps = LONGER[option]
    assert train_command("--out", folder, "--resume", option, value) == 0
    record = json.loads((folder / "config.json").read_text())
    assert (record["steps"], record["earlier_lengths"]) == (steps, [[6, 6]])
    # as often as a preview is made, and at the ends
    assert [line["step"] for line in metrics(folder)] == [3, 6, 9, steps]
    seconds = [line["seconds"] for line in metrics(folder)]
    assert seconds == sorted(seconds)
    # what had begun before stays on, although the new length has it begin later
    assert {"normal_prior", "response"} <= set(metrics(folder)[-1])
    assert checkpoints(folder)[-1] == f"step_{steps:06d}"
    assert not same_bits(tiny_run, folder)
    # the same command again has nothing more to do, and neither has one without the option
    before = (folder / "avatar" / "avatar.safetensors").read_bytes()
    for arguments in ([option, value], []):
        capsys.readouterr()
        assert train_command("--out", folder, "--resume", *arguments) == 0
        assert f"all {steps} steps are done; --max-steps MORE or --epochs MORE" in capsys.readouterr().err
        assert (folder / "avatar" / "avatar.safetensors").read_bytes() == before


def test_the_same_length_by_another_option_is_no_extension(tiny_dataset, tmp_path):
    arguments = train_arguments(tiny_dataset, tmp_path / "run", "--epochs", 1)  # four steps, not six
    assert train_command(*arguments) == 0
    before = (tmp_path / "run" / "config.json").read_bytes()
    assert train_command("--out", tmp_path / "run", "--resume", "--max-steps", 4) == 0
    assert (tmp_path / "run" / "config.json").read_bytes() == before


def test_an_extended_run_that_is_killed_goes_on_to_the_same_bits(tiny_run, tmp_path):
    whole, killed = (shutil.copytree(tiny_run, tmp_path / name) for name in ("whole", "killed"))
    assert train_command("--out", whole, "--resume", "--max-steps", 11) == 0
    # in the first step of the extension, before it has saved anything
    ended = end_by("SIGKILL", ["--out", str(killed), "--resume", "--max-steps", "11"], at=6)
    assert ended.returncode == -signal.SIGKILL
    assert train_command("--out", killed, "--resume") == 0
    assert same_bits(whole, killed)
    assert (whole / "config.json").read_bytes() == (killed / "config.json").read_bytes()


def test_extending_an_unfinished_run_follows_the_new_length(tiny_run, tmp_path):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    shutil.rmtree(folder / "checkpoints" / "step_000006")
    assert train_command("--out", folder, "--resume", "--max-steps", 8) == 0
    assert json.loads((folder / "config.json").read_text())["earlier_lengths"] == [[6, 3]]


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


def test_before_the_first_checkpoint_a_run_starts_from_the_beginning(
    tiny_run, tiny_dataset, tmp_path, capsys
):
    run = tmp_path / "run"
    assert train_command(*train_arguments(tiny_dataset, run, "--resume")) == 0
    assert f"no checkpoint in {run} yet: starting from the beginning" in capsys.readouterr().err
    assert same_bits(tiny_run, run)


def test_a_run_that_was_killed_before_its_first_checkpoint_keeps_its_settings(tiny_dataset, tmp_path, capsys):
    run = tmp_path / "run"
    arguments = train_arguments(tiny_dataset, run, "--seed", 7)
    assert end_by("SIGKILL", arguments, at=1).returncode == -signal.SIGKILL
    assert not (run / "checkpoints").exists()
    assert "--seed: expected 7 as the run was begun" in refused(capsys, *arguments, "--seed", 8, "--resume")
    assert train_command("--out", run, "--resume") == 0
    assert "starting from the beginning" in capsys.readouterr().err
    assert json.loads((run / "config.json").read_text())["settings"]["seed"] == 7
    assert json.loads((run / "config.json").read_text())["earlier_lengths"] == []
    assert train_command(*train_arguments(tiny_dataset, tmp_path / "whole", "--seed", 7)) == 0
    assert same_bits(tmp_path / "whole", run)


def test_a_checkpoint_that_is_not_whole_is_not_begun_anew(tiny_run, tmp_path, capsys):
    folder = shutil.copytree(tiny_run, tmp_path / "run")
    for path in folder.glob("checkpoints/*/training.json"):
        path.unlink()
    assert f"{folder / 'checkpoints'}: expected a checkpoint" in refused(capsys, "--out", folder, "--resume")


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
