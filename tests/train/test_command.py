"""``python -m samira_warp.train`` from its options to its files."""

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import fields

import numpy as np
import OpenImageIO
import pytest
import torch
from data.damage import change_json
from safetensors.torch import load_file
from subjects import STEPS, train_arguments, train_command

from samira_warp.__main__ import main
from samira_warp.avatar import Avatar, read_frames
from samira_warp.io.images import read_image
from samira_warp.train.config import PRESETS, TrainConfig
from samira_warp.train.settings import DEFAULTS, Settings, resolve


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def same_bits(first, second):
    return (first / "avatar" / "avatar.safetensors").read_bytes() == (
        second / "avatar" / "avatar.safetensors"
    ).read_bytes()


def test_a_run_folder_holds_what_the_contract_says(tiny_run):
    names = {path.name for path in tiny_run.iterdir()}
    events = {name for name in names if name.startswith("events.out.tfevents")}
    assert len(events) == 1
    assert names - events == {
        "config.json",
        "metrics.jsonl",
        "checkpoints",
        "avatar",
        "results.json",
        "preview",
    }
    assert {path.name for path in (tiny_run / "avatar").iterdir()} == {
        "avatar.json",
        "avatar.safetensors",
        "frames.safetensors",
        "light_diffuse.exr",
        "light_specular.exr",
        "template.npz",
    }
    assert sorted(path.name for path in (tiny_run / "checkpoints").iterdir()) == [
        "step_000003",
        "step_000006",
    ]
    assert sorted(path.name for path in (tiny_run / "preview").iterdir()) == ["000003.png", "000006.png"]


def test_config_tells_how_the_run_was_made(tiny_run, tiny_dataset):
    record = json.loads((tiny_run / "config.json").read_text())
    assert record["settings"]["seed"] == 42
    assert record["settings"]["data"] == str(tiny_dataset)
    assert set(record["settings"]) == {field.name for field in fields(Settings)}
    assert all(
        value is not None for name, value in record["settings"].items() if DEFAULTS.get(name, 0) is not None
    )
    assert (record["steps"], record["train_frames"], record["test_frames"]) == (STEPS, 4, 2)
    assert (record["encoder"], record["split"], record["subject"]) == ("random", "dataset", "subject")
    assert len(record["template_hash"]) == 64
    assert {"python", "torch", "warp-lang", "samira-warp"} <= set(record["versions"])
    described = json.loads((tiny_run / "avatar" / "avatar.json").read_text())
    assert described["record"]["split"] == "dataset"
    assert described["record"]["template"] == record["template_hash"]


def test_metrics_end_with_the_last_step(tiny_run):
    last = lines(tiny_run / "metrics.jsonl")[-1]
    assert last["step"] == STEPS
    assert last["gaussians"] > 0
    terms = {
        "l1",
        "ssim",
        "mask",
        "residual",
        "albedo",
        "normal_smoothness",
        "normal_prior",
    }
    terms |= {"response", "light", "materials", "wrinkles"}
    assert terms <= set(last)
    assert last["loss"] == pytest.approx(sum(last[name] for name in terms))
    assert all(math.isfinite(value) for value in last.values())


def test_metrics_tell_the_time_and_the_psnr_of_test_frames(tiny_run):
    """There are two test frames, so that what is measured at the end is what is reported, but for 8 bits."""
    metrics, results = lines(tiny_run / "metrics.jsonl"), json.loads((tiny_run / "results.json").read_text())
    assert [line["step"] for line in metrics if "test_psnr" in line] == [3, STEPS]
    # half a level of 255 moves an error of 0.1 (20 dB) by at most 2 %, 0.17 dB
    assert metrics[-1]["test_psnr"] == pytest.approx(results["psnr"], abs=0.17)
    seconds = [line["seconds"] for line in metrics]
    assert 0.0 < seconds[0] < seconds[-1]


def test_results_score_the_test_frames_and_name_the_protocol(tiny_run):
    results = json.loads((tiny_run / "results.json").read_text())
    assert set(results["frames"]) == {"00004_00", "00005_00"}
    for name in ("psnr", "ssim", "l1", "psnr_foreground"):
        mean = sum(frame[name] for frame in results["frames"].values()) / 2
        assert results[name] == pytest.approx(mean)
    assert 10 < results["psnr"] < 40
    assert results["lpips"] is not None or results["lpips_reason"]
    assert results["protocol"]["lpips_training"] in (None, "alex")
    assert results["protocol"]["size"] == [32, 32]
    assert "dataset" in results["protocol"]["split"]
    assert results["protocol"]["background"] == "white"


def test_previews_show_five_panels_and_the_light(tiny_run):
    image = OpenImageIO.ImageInput.open(str(tiny_run / "preview" / f"{STEPS:06d}.png"))
    assert (image.spec().width, image.spec().height) == (6 * 32, 32)
    image.close()


def test_a_tied_light_is_one_map_in_avatar_and_preview(tiny_dataset, tmp_path):
    assert train_command(*train_arguments(tiny_dataset, tmp_path / "run", "--tie-light")) == 0
    avatar = Avatar.load(tmp_path / "run")
    assert avatar.settings.tied_light
    assert avatar.light.specular.std() > 0
    panel = read_image(tmp_path / "run" / "preview" / f"{STEPS:06d}.png", channels=3)[:, 5 * 32 :]
    # diffuse above specular: the same map twice
    assert np.array_equal(panel[:16], panel[16:])
    assert 0.3 < panel.mean() < 0.9


def test_the_avatar_keeps_its_frames_fitted_where_it_trained(tiny_run, tiny_dataset):
    from samira_warp.data import open_sequence

    sequence = open_sequence(tiny_dataset)
    tracked = {frame.name: frame.parameters for frame in sequence.frames}
    frames = read_frames(tiny_run)
    assert [frame.part for frame in frames] == ["test"] * 2 + ["train"] * 4
    for frame in frames:
        unchanged = torch.equal(frame.parameters.expression, tracked[frame.name].expression)
        assert unchanged is (frame.part == "test"), frame.name


def test_training_learns(tiny_run):
    """What the last checkpoint holds differs from the first in every group that has a gradient by then."""
    first, last = (
        load_file(tiny_run / "checkpoints" / f"step_{step:06d}" / "avatar.safetensors") for step in (3, 6)
    )
    for name in (
        "light.diffuse",
        "light.specular",
        "response_logits",
        "motion.residual.weight",
        "motion.gates",
    ):
        assert not torch.equal(first[name], last[name]), name


def test_two_equal_runs_give_the_same_bits(tiny_run, tiny_dataset, tmp_path, capsys):
    assert train_command(*train_arguments(tiny_dataset, tmp_path / "again")) == 0
    assert same_bits(tiny_run, tmp_path / "again")
    printed = capsys.readouterr().out.strip().splitlines()
    assert json.loads(printed[-1])["psnr"] == json.loads((tiny_run / "results.json").read_text())["psnr"]


def test_another_seed_gives_another_avatar(tiny_run, tiny_dataset, tmp_path):
    assert train_command(*train_arguments(tiny_dataset, tmp_path / "other", "--seed", 7)) == 0
    assert not same_bits(tiny_run, tmp_path / "other")


def test_the_command_itself(tiny_dataset, tmp_path, capsys):
    """A real process with the real preset: two steps, nothing but the result on standard output."""
    options = [
        "--resolution",
        "24",
        "--gaussians",
        "100",
        "--max-steps",
        "2",
        "--encoder",
        "random",
        "--device",
        "cpu",
        "--split",
        "0.5",
    ]
    command = [
        sys.executable,
        "-m",
        "samira_warp.train",
        "--data",
        str(tiny_dataset),
        "--out",
        str(tmp_path / "run"),
        *options,
    ]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "HF_HUB_OFFLINE": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["psnr"] > 5
    assert "Traceback" not in done.stderr
    assert "3 training and 3 test frames" in done.stderr
    # the end says where the avatar is, how it scores and what to do next
    run = tmp_path / "run"
    said = done.stderr[
        done.stderr.index(f"the avatar is in {run / 'avatar'}; on 3 test frames of 24 x 24:") :
    ]
    table = dict(re.split(r"  +", line.strip()) for line in said.splitlines()[1:7])
    assert table["PSNR"] == f"{json.loads(done.stdout)['psnr']:.2f} dB"
    assert table["LPIPS"].startswith("none: ")
    # the commands that it names run as they are written
    commands = [shlex.split(line) for line in said.splitlines() if line.startswith("  python -m ")]
    assert [words[2] for words in commands] == 2 * ["samira_warp.render"] + ["samira_warp.evaluate"]
    for words in commands:
        capsys.readouterr()
        assert main([words[2].removeprefix("samira_warp."), *words[3:]]) == 0
    again, results = json.loads(capsys.readouterr().out), json.loads((run / "results.json").read_text())
    assert again["psnr"] == pytest.approx(results["psnr"])
    assert (run / "relit" / "image" / "00004_00.png").is_file()
    assert (
        json.loads((tmp_path / "run" / "avatar" / "avatar.json").read_text())["settings"]["uv_size"]
        == PRESETS["cpu"].uv_size
    )


def test_defaults_follow_the_machine(tmp_path):
    resolved = resolve(TrainConfig(), data=tmp_path / "ict_a", out=tmp_path / "run")
    gpu = torch.cuda.is_available()
    assert resolved.preset == ("paper" if gpu else "cpu")
    assert resolved.resolution == PRESETS[resolved.preset].resolution
    assert resolved.gaussians == PRESETS[resolved.preset].gaussians


def test_every_setting_can_be_asked_for_and_is_none_until_then():
    """What is asked for can be told from what is not, even where it asks for the default."""
    asked, resolved = fields(TrainConfig), {field.name for field in fields(Settings)}
    assert {field.name for field in asked} - {"resume"} == resolved
    assert {field.name for field in asked if field.default is not None} == {"resume"}


def test_help_names_the_default_that_holds(capsys):
    with pytest.raises(SystemExit):
        train_command("--help")
    words = " ".join(capsys.readouterr().out.replace("│", " ").split())
    sentences = dict(re.findall(r"--([a-z-]+),? (.*?)(?= --[a-z-]+,? |$)", words))
    for name, value in DEFAULTS.items():
        if name not in ("tie_light", "jitter", "ablate") and value is not None:
            assert f"default {value}" in sentences[name.replace("_", "-")], name


def test_the_run_folder_is_called_after_the_dataset(tiny_dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = train_arguments(tiny_dataset, "unused")
    del arguments[arguments.index("--out") : arguments.index("--out") + 2]
    arguments[arguments.index(str(STEPS))] = "1"
    assert train_command(*arguments) == 0
    assert (tmp_path / "runs" / "subject" / "avatar" / "avatar.json").is_file()


def test_epochs_decide_the_steps_where_max_steps_does_not(tiny_dataset, tmp_path):
    arguments = [
        word
        for word in train_arguments(tiny_dataset, tmp_path / "run")
        if word not in ("--max-steps", str(STEPS))
    ]
    assert train_command(*arguments, "--epochs", 1) == 0
    assert json.loads((tmp_path / "run" / "config.json").read_text())["steps"] == 4


@pytest.mark.parametrize(
    ("asked", "steps"),
    [
        ({}, 1200),  # four passes over 100 frames would be less
        ({"epochs": 2}, 200),
        ({"max_steps": 30}, 30),
        ({"max_steps": 5000}, 5000),
        ({"epochs": 2, "max_steps": 500}, 200),
        ({"epochs": 9, "max_steps": 500}, 500),
    ],
)
def test_the_length_is_what_is_asked_for_or_the_presets(tmp_path, asked, steps):
    config = TrainConfig(data=tmp_path, out=tmp_path, preset="cpu", device="cpu", **asked)
    assert resolve(config, data=tmp_path, out=tmp_path).steps(100) == steps


def test_longer_films_get_four_passes_and_ten_with_the_papers_preset(tmp_path):
    lengths = {}
    for preset in ("cpu", "paper"):
        config = TrainConfig(data=tmp_path, out=tmp_path, preset=preset, device="cpu")
        lengths[preset] = resolve(config, data=tmp_path, out=tmp_path).steps(500)
    assert lengths == {"cpu": 2000, "paper": 5000}


def test_frames_without_a_matte_train_without_the_terms_that_need_one(tiny_dataset, tmp_path):
    dataset = shutil.copytree(tiny_dataset, tmp_path / "subject")
    shutil.rmtree(dataset / "fg_masks")
    for path in dataset.glob("transforms*.json"):
        change_json(path, lambda document: [entry.pop("fg_mask_path") for entry in document["frames"]])
    assert train_command(*train_arguments(dataset, tmp_path / "run")) == 0
    terms = set(lines(tmp_path / "run" / "metrics.jsonl")[-1])
    assert {"l1", "ssim", "residual"} <= terms
    assert not {"mask", "albedo"} & terms
    assert 5 < json.loads((tmp_path / "run" / "results.json").read_text())["psnr"] < 40


def test_pictures_smaller_than_the_training_size_are_said_to_be_enlarged(tiny_dataset, tmp_path, capsys):
    arguments = train_arguments(tiny_dataset, tmp_path / "run")
    arguments[arguments.index(str(STEPS))] = "1"
    assert train_command(*arguments) == 0
    assert "enlarged" not in capsys.readouterr().err
    arguments = [str(tmp_path / "large") if word == str(tmp_path / "run") else word for word in arguments]
    assert train_command(*arguments, "--resolution", 40) == 0
    said = capsys.readouterr().err
    assert "pictures of 32 x 32 pixels are enlarged to 40 x 40" in said
    assert "--resolution 32" in said
