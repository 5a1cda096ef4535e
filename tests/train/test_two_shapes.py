"""Cameras of two shapes: a landscape and a portrait one are trained, scored, kept and shown as they are."""

import json

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from data.tiny import crop_to_two_shapes, make_tiny_dataset
from subjects import render_command, train_arguments, train_command

from samira_warp.avatar import read_frames
from samira_warp.data import PixelCache, open_sequence
from samira_warp.evaluate.__main__ import main as evaluate_main
from samira_warp.evaluate.config import EvaluateConfig
from samira_warp.io.images import image_size, read_image
from samira_warp.support.cli import run

SHAPES = [(32, 24), (24, 32)]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return crop_to_two_shapes(make_tiny_dataset(tmp_path_factory.mktemp("two") / "subject", size=48))


@pytest.fixture(scope="module")
def run_folder(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("two run") / "out"
    assert train_command(*train_arguments(dataset, folder)) == 0
    return folder


@pytest.fixture(scope="module")
def rendered(run_folder, tmp_path_factory):
    folder = tmp_path_factory.mktemp("two pictures") / "out"
    layers = ("--layers", "image", "alpha")
    assert render_command("--avatar", run_folder, "--out", folder, *layers, "--video", "--fps", 10) == 0
    return folder


def shape_of(name):
    return SHAPES[int(name[:5]) % 2]


def test_pixels_have_their_own_cameras_shape(dataset):
    sequence = open_sequence(dataset)
    with PixelCache(sequence.frames, resolution=32) as pixels:
        for index, frame in enumerate(sequence.frames):
            width, height = shape_of(frame.name)
            assert pixels[index].image.shape == (height, width, 3)
            # a sphere stays one: its matte is as wide as high, to the pixel that each border may round
            rows, columns = ((pixels[index].mask > 0.5).any(dim=side).sum() for side in (1, 0))
            assert abs(int(rows) - int(columns)) <= 1


def test_the_avatar_keeps_every_camera_as_it_is(dataset, run_folder):
    cameras = {frame.name: frame.camera for frame in open_sequence(dataset).frames}
    for frame in read_frames(run_folder):
        own, kept = cameras[frame.name], frame.camera
        assert (kept.width, kept.height) == shape_of(frame.name)
        scale = 32 / 48
        for name in ("fx", "fy", "cx", "cy"):
            assert getattr(kept, name) == pytest.approx(scale * getattr(own, name), rel=1e-6)
        torch.testing.assert_close(kept.world_to_camera, own.world_to_camera)


def test_pictures_have_their_cameras_shape_and_the_head_its_own(dataset, rendered):
    for name in ("00004_00", "00005_00"):
        path = rendered / "alpha" / f"{name}.png"
        assert image_size(path) == image_size(rendered / "image" / f"{name}.png") == shape_of(name)
        covered = read_image(path, channels=1)[..., 0] > 0.5
        # Gaussians reach beyond the sphere by up to a pixel at either border, which may round
        assert abs(int(covered.any(axis=0).sum()) - int(covered.any(axis=1).sum())) <= 3


def test_scores_are_those_of_pictures_of_their_own_shape(dataset, run_folder, rendered, capsys):
    results = json.loads((run_folder / "results.json").read_text())
    assert results["protocol"]["sizes"] == [list(shape) for shape in SHAPES]
    capsys.readouterr()
    arguments = ["--pred", str(rendered), "--data", str(dataset)]
    assert run(evaluate_main, EvaluateConfig, program="evaluate", arguments=arguments) == 0
    scores = json.loads(capsys.readouterr().out)
    for name in ("psnr", "ssim", "l1", "psnr_foreground"):
        # both are 8-bit renders of the same avatar; the cache keeps the truth in 16 bits
        assert scores[name] == pytest.approx(results[name], rel=1e-3), name


def test_the_film_has_the_first_shape_and_says_so_once(run_folder, tmp_path, capfd):
    assert render_command("--avatar", run_folder, "--out", tmp_path, "--video", "--fps", 10) == 0
    notes = [line for line in capfd.readouterr().err.splitlines() if line.startswith("note:")]
    assert len(notes) == 1
    assert "the film is 32 x 24 and its pictures 32 x 24 or 24 x 32" in notes[0]
    stream = imageio_ffmpeg.read_frames(str(tmp_path / "image.mp4"))
    assert next(stream)["size"] == (32, 24)
    first, second = (np.frombuffer(frame, np.uint8).reshape(24, 32, 3) / 255.0 for frame in stream)
    # the portrait picture is 18 wide where it is 24 high, with 7 columns of white at either side; a codec's
    # block may ring by a column
    assert second[:, :6].min() > 0.95
    assert second[:, 26:].min() > 0.95
    for frame in (first, second):
        dark = frame.mean(axis=2) < 0.8
        assert abs(int(dark.any(axis=0).sum()) - int(dark.any(axis=1).sum())) <= 3


def test_what_was_trained_is_told_with_both_sizes(dataset, tmp_path, capfd):
    assert train_command(*train_arguments(dataset, tmp_path / "run", "--resolution", 64)) == 0
    said = capfd.readouterr().err
    assert "pictures of 48 x 36 pixels are enlarged to 64 x 48" in said
    assert "test frames of 64 x 48 or 48 x 64" in said
