"""An avatar's own renderer finds back the motion that was taken from a tracking."""

import shutil

import numpy as np
import pytest
import torch

from samira_warp.avatar import Avatar
from samira_warp.data import open_sequence
from samira_warp.head import Rig
from samira_warp.io.images import write_png
from samira_warp.prepare import refining
from samira_warp.prepare.refining import refine_dataset
from samira_warp.support.errors import UserError

SHIFT = 0.003
"""Metres: one pixel of 64 where a head of 0.25 m fills them."""


@pytest.fixture
def shifted(built_in_run, built_in_datasets, tmp_path):
    """What the run's avatar draws of its dataset, with a tracking that is off to one side by `SHIFT`."""
    folder, avatar = tmp_path / "shifted", Avatar.load(built_in_run)
    shutil.copytree(built_in_datasets["VHAP export"], folder)
    for frame in open_sequence(folder, split="0.5").frames:
        with torch.no_grad():
            image = avatar.render(frame.parameters, frame.camera).image
        write_png(frame.image_path, image.clamp(0.0, 1.0).numpy())
    for path in (folder / "flame_param").iterdir():
        arrays = dict(np.load(path))
        arrays["translation"] = arrays["translation"] + np.array([[SHIFT, 0.0, 0.0]], np.float32)
        np.savez(path, **arrays)
    return folder


def face_of(folder):
    """(N, M, 2) where the face's vertices are seen in the frames, pixels."""
    sequence = open_sequence(folder, split="0.5")
    rig, pixels = Rig.build(sequence.template), []
    face = torch.from_numpy(sequence.template.masks["face"]).long()
    for frame in sequence.frames:
        camera = frame.camera
        vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices[face]
        points = vertices @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        pixels.append(points[:, :2] / points[:, 2:] * torch.tensor([camera.fx, camera.fy]))
    return torch.stack(pixels)


def test_a_tracking_that_is_off_comes_back(built_in_run, built_in_datasets, shifted, tmp_path, monkeypatch):
    monkeypatch.setattr(refining, "RESOLUTION", 64)
    said = []
    target = tmp_path / "refined"
    target.mkdir()
    refine_dataset(Avatar.load(built_in_run), shifted, target, say=said.append)
    truth = face_of(built_in_datasets["VHAP export"])
    before, after = ((face_of(folder) - truth).norm(dim=2).median() for folder in (shifted, target))
    # a turn moves the face as a shift does, so that places are compared and not parameters
    assert after < 0.5 * before
    assert "refined by the avatar" in said[0]


def test_an_avatar_of_another_head_is_refused(built_in_run, tiny_dataset, tmp_path):
    with pytest.raises(UserError, match="head model"):
        refine_dataset(Avatar.load(built_in_run), tiny_dataset, tmp_path, say=print)
