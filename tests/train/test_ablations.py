"""Every ``--ablate`` name trains, and leaves out what it names."""

import json
from typing import get_args

import pytest
import torch
from safetensors.torch import load_file
from subjects import STEPS, train_arguments, train_command

from samira_warp.train.config import Ablation

SETTINGS = {
    "no-residual": lambda settings: not settings["residual"],
    "no-routing": lambda settings: not settings["motion"]["routing"],
    "no-displacement": lambda settings: not settings["motion"]["displacement"],
    "no-modulation": lambda settings: not settings["motion"]["modulation"],
    "no-response": lambda settings: not settings["response"],
    "no-wrinkles": lambda settings: not settings["motion"]["wrinkles"],
    "no-visibility": lambda settings: not settings["visibility"],
}
"""What the saved avatar says of itself; the other ablations concern the loss and the schedule alone."""


def run(data, folder, *options, steps=3):
    arguments = train_arguments(data, folder, *options)
    arguments[arguments.index(str(STEPS))] = str(steps)
    assert train_command(*arguments) == 0
    settings = json.loads((folder / "avatar" / "avatar.json").read_text())["settings"]
    metrics = json.loads((folder / "metrics.jsonl").read_text().splitlines()[-1])
    return settings, metrics, load_file(folder / "avatar" / "avatar.safetensors")


def test_every_name_is_covered_by_a_test():
    elsewhere = {"no-two-stage", "no-normal-prior", "no-albedo", "no-mask"}
    assert set(SETTINGS) | elsewhere == set(get_args(Ablation))


@pytest.mark.parametrize("name", SETTINGS)
def test_ablations_of_the_model(tiny_dataset, tmp_path, name):
    settings, _, tensors = run(tiny_dataset, tmp_path / "run", "--ablate", name)
    assert [other for other, holds in SETTINGS.items() if holds(settings)] == [name]
    assert (tensors["motion.residual.weight"] == 0).all().item() is (name == "no-residual")
    assert (tensors["response_logits"] == 0).all().item() is (name == "no-response")


def test_ablations_of_the_loss_alone(tiny_dataset, tmp_path):
    _, full, _ = run(tiny_dataset, tmp_path / "full")
    assert all(full[name] > 0 for name in ("normal_prior", "albedo", "mask"))
    settings, ablated, _ = run(
        tiny_dataset, tmp_path / "run", "--ablate", "no-normal-prior", "no-albedo", "no-mask"
    )
    assert not any(holds(settings) for holds in SETTINGS.values())
    assert ablated["mask"] == 0
    assert ablated["normal_prior"] == 0
    assert "albedo" not in ablated


def test_without_two_stages_normals_and_responses_learn_from_the_first_step(tiny_dataset, tmp_path):
    _, metrics, tensors = run(tiny_dataset, tmp_path / "two", steps=1)
    assert "normal_prior" not in metrics
    assert torch.equal(tensors["gaussians.normals"], tensors["gaussians.initial_normals"])
    assert (tensors["response_logits"] == 0).all()
    _, metrics, tensors = run(tiny_dataset, tmp_path / "one", "--ablate", "no-two-stage", steps=1)
    assert "normal_prior" in metrics
    assert not torch.equal(tensors["gaussians.normals"], tensors["gaussians.initial_normals"])
    assert (tensors["response_logits"] != 0).any()


def test_variants_of_the_literal_paper(tiny_dataset, tmp_path):
    options = [
        "--reference",
        "screen",
        "--displacement",
        "world",
        "--residual-frame",
        "head",
        "--normals",
        "face",
        "--color-space",
        "raw",
    ]
    settings, metrics, tensors = run(tiny_dataset, tmp_path / "run", *options)
    assert (settings["displacement_frame"], settings["residual_frame"], settings["color_space"]) == (
        "world",
        "head",
        "raw",
    )
    assert (tensors["gaussians.initial_normals"] == torch.tensor([0.0, 1.0, 0.0])).all()
    assert metrics["psnr"] > 5
