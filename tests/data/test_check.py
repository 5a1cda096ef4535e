"""``python -m samira_warp.check``."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from data.damage import change_arrays, change_json, widen, with_value
from data.layouts import make_film_for, write_layout
from data.tiny import make_tiny_dataset, tiny_template

from samira_warp.check.__main__ import CheckConfig, main
from samira_warp.cli import run


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


def check(*arguments):
    return run(main, CheckConfig, program="python -m samira_warp.check", arguments=[*map(str, arguments)])


def facts(capsys, *arguments):
    assert check(*arguments) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return {name: value.strip() for name, value in (line.split(":", 1) for line in captured.out.splitlines())}


def test_what_a_dataset_holds(tiny_dataset, capsys):
    said = facts(capsys, "--data", tiny_dataset)
    vertices = said.pop("template")
    assert vertices.startswith(f"{tiny_dataset / 'template.npz'}: 328 vertices, ")
    assert vertices.endswith("2 identity and 4 expression coefficients")
    assert said == {
        "folder": str(tiny_dataset),
        "format": "VHAP export",
        "frames": "6 at 6 timesteps",
        "split": "dataset: 4 train, 2 test",
        "size": "32 x 32",
        "static offset": "none",
        "masks": "6 of 6 frames",
        "albedo": "4 of 6 frames",
    }


def test_what_was_done_about_a_folder_is_said(tmp_path, capsys):
    root = write_layout("IMavatar", make_film_for("IMavatar"), tmp_path / "subject")
    np.savez(root / "template.npz", **tiny_template())
    said = facts(capsys, "--data", root)
    assert said["format"] == "IMavatar's flame_params.json"
    assert said["note"] == "the dataset has no division of its own: the first 70 % of its timesteps train"


def test_another_split(tiny_dataset, capsys):
    assert facts(capsys, "--data", tiny_dataset, "--split", "last:1")["split"] == "last:1: 5 train, 1 test"


def test_what_is_absent_is_said(tmp_path, capsys):
    root = make_tiny_dataset(tmp_path / "subject", frames=4, static_offset=True)
    for name in ("transforms_train.json", "transforms_test.json"):
        change_json(root / name, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"]])
    shutil.rmtree(root / "albedo")
    said = facts(capsys, "--data", root)
    assert (said["masks"], said["albedo"], said["static offset"]) == ("0 of 4 frames", "0 of 4 frames", "present")


def test_a_head_model_from_elsewhere(dataset, tmp_path, capsys):
    (dataset / "template.npz").rename(tmp_path / "flame.npz")
    assert facts(capsys, "--data", dataset, "--flame", tmp_path / "flame.npz")["template"].startswith(str(tmp_path / "flame.npz"))


FIRST = "flame_param/00000.npz"
DAMAGES = {
    "no list": ("transforms_train.json", os.unlink),
    "no image": ("images/00001_00.png", os.unlink),
    "a mask of another size": ("fg_masks/00001_00.png", widen),
    "no key": (FIRST, lambda path: change_arrays(path, expr=None)),
    "another shape": (FIRST, lambda path: change_arrays(path, expr=lambda a: a[:, 1:])),
    "NaN": (FIRST, lambda path: change_arrays(path, expr=with_value(float("nan")))),
    "no template": ("template.npz", os.unlink),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_fault_is_one_line_and_status_2(dataset, capsys, name):
    file, damage = DAMAGES[name]
    damage(dataset / file)
    assert check("--data", dataset) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"error: {dataset / file}")
    assert captured.err.count("\n") == 1


def test_an_unknown_option_is_status_2(tiny_dataset, capsys):
    with pytest.raises(SystemExit) as caught:
        check("--data", tiny_dataset, "--spilt", "0.5")
    assert caught.value.code == 2
    assert "--spilt" in capsys.readouterr().err


def test_the_process_says_one_line(dataset):
    change_arrays(dataset / FIRST, jaw_pose=with_value(float("nan")))
    command = [sys.executable, "-m", "samira_warp.check", "--data", str(dataset)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"error: {dataset / FIRST}: jaw_pose: expected finite numbers, found 1 that are not\n"
