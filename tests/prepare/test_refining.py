"""An avatar's own renderer finds back the motion that was taken from a tracking."""

import shutil

import numpy as np
import pytest

from samira_warp.avatar import Avatar
from samira_warp.data import open_sequence
from samira_warp.prepare import refining
from samira_warp.prepare.refining import refine_dataset
from samira_warp.support.errors import UserError

SHIFT = 0.003
"""Metres: one pixel of 64 where a head of 0.25 m fills them."""


@pytest.fixture
def shifted(built_in_datasets, tmp_path):
    """The dataset of the run, its tracking off to one side by `SHIFT`."""
    folder = tmp_path / "shifted"
    shutil.copytree(built_in_datasets["VHAP export"], folder)
    for path in (folder / "flame_param").iterdir():
        arrays = dict(np.load(path))
        arrays["translation"] = arrays["translation"] + np.array([[SHIFT, 0.0, 0.0]], np.float32)
        np.savez(path, **arrays)
    return folder


def across(folder):
    """Mean x of the frames' translations."""
    frames = open_sequence(folder, split="0.5").frames
    return np.array([float(frame.parameters.translation[0]) for frame in frames])


def test_a_tracking_that_is_off_comes_back(built_in_run, built_in_datasets, shifted, tmp_path, monkeypatch):
    monkeypatch.setattr(refining, "RESOLUTION", 64)
    said = []
    target = tmp_path / "refined"
    target.mkdir()
    refine_dataset(Avatar.load(built_in_run), shifted, target, say=said.append)
    truth = across(built_in_datasets["VHAP export"])
    before, after = (np.abs(across(folder) - truth).mean() for folder in (shifted, target))
    assert before == pytest.approx(SHIFT, rel=1e-3)
    # a run of a few steps draws a blurred head, which tells half a pixel at least
    assert after < 0.5 * before
    assert "refined by the avatar" in said[0]


def test_an_avatar_of_another_head_is_refused(built_in_run, tiny_dataset, tmp_path):
    with pytest.raises(UserError, match="head model"):
        refine_dataset(Avatar.load(built_in_run), tiny_dataset, tmp_path, say=print)
