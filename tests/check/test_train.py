"""What train says of a dataset before it begins."""

import shutil

import numpy as np
import pytest
from data.damage import change_arrays, change_json, with_value
from data.layouts import FLIP
from subjects import train_arguments, train_command

from samira_warp.check.opening import open_checked
from samira_warp.io.images import read_image, write_png


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


def refused(dataset, capsys):
    """The one line that train says; it leaves no run folder."""
    out = dataset.parent / "run"
    assert train_command(*train_arguments(dataset, out)) == 2
    assert not out.exists()
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_one_fault_is_said_as_it_is(dataset, capsys):
    path = dataset / "flame_param" / "00001.npz"
    change_arrays(path, expr=with_value(np.nan))
    assert refused(dataset, capsys) == f"error: {path}: expr: expected finite numbers, found 1 that are not"


def test_of_many_faults_the_first_and_how_to_see_the_others(dataset, capsys):
    for index in (1, 3):
        (dataset / "flame_param" / f"{index:05d}.npz").unlink()
    (dataset / "images" / "00002_00.png").write_bytes(b"text")
    line = refused(dataset, capsys)
    assert line.startswith(f"error: {dataset / 'flame_param' / '00001.npz'}: expected the file that")
    assert line.endswith(f"(and 2 more faults: python -m samira_warp.check --data {dataset})")


def test_a_head_behind_the_camera_is_not_trained(dataset, capsys):
    for name in ("transforms_train.json", "transforms_test.json"):
        change_json(
            dataset / name,
            lambda d: [
                entry.update(transform_matrix=(np.array(entry["transform_matrix"]) @ FLIP).tolist())
                for entry in d["frames"]
            ],
        )
    line = refused(dataset, capsys)
    assert "expected the head before the camera, found it behind in 6 of 6 frames looked at" in line
    assert "negate columns two and three" in line


def test_what_is_for_a_person_to_judge_is_a_warning(dataset, capsys):
    for path in (dataset / "fg_masks").iterdir():
        write_png(path, np.roll(read_image(path, channels=3), 16, axis=1))
    sequence = open_checked(dataset)
    assert len(sequence.frames) == 6
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {dataset / 'fg_masks'}: expected the tracked head within its mask")
