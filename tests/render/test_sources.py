"""Where the frames to render come from: the avatar's own, or a dataset's folder, as the avatar was trained on
it."""

import json
import shutil

import numpy as np
import pytest
from data.damage import change_arrays
from data.tiny import make_tiny_dataset, tiny_template
from subjects import render_command, train_arguments, train_command

from samira_warp.avatar import Avatar, read_frames
from samira_warp.evaluate.__main__ import EvaluateConfig
from samira_warp.evaluate.__main__ import main as evaluate_main
from samira_warp.support.cli import run


def pictures(folder):
    """Bytes of the rendered images by name."""
    return {path.stem: path.read_bytes() for path in sorted((folder / "image").iterdir())}


def render(*arguments):
    assert render_command(*arguments) == 0


@pytest.fixture(scope="module")
def with_offset(tmp_path_factory):
    """A subject whose static offset of some millimetres shows, and its finished run."""
    root = tmp_path_factory.mktemp("offset")
    dataset = make_tiny_dataset(root / "subject", static_offset=True)
    offset = 0.004 * np.sin(60.0 * tiny_template()["v_template"])[None, :, [1, 2, 0]]
    for path in [*dataset.glob("flame_param/*.npz"), dataset / "canonical_flame_param.npz"]:
        change_arrays(path, static_offset=offset.astype(np.float32))
    assert train_command(*train_arguments(dataset, root / "run")) == 0
    return dataset, root / "run"


def test_a_static_offset_is_there_with_and_without_the_dataset(with_offset, tmp_path):
    dataset, trained = with_offset
    render("--avatar", trained, "--out", tmp_path / "own")
    render("--avatar", trained, "--out", tmp_path / "data", "--data", dataset)
    own = pictures(tmp_path / "own")
    assert set(own) == {"00004_00", "00005_00"}
    assert own == pictures(tmp_path / "data")
    assert all(frame.parameters.dynamic_offset is None for frame in read_frames(trained))


def test_a_static_offset_was_there_when_the_run_was_scored(with_offset, tmp_path, capsys):
    dataset, trained = with_offset
    render("--avatar", trained, "--out", tmp_path / "with")
    flat = shutil.copytree(trained / "avatar", tmp_path / "avatar")
    avatar = Avatar.load(flat)
    avatar.canonical.static_offset.zero_()
    avatar.save(flat, record={})
    render("--avatar", flat, "--out", tmp_path / "without")
    scores = {}
    for name in ("with", "without"):
        capsys.readouterr()
        arguments = ["--pred", str(tmp_path / name), "--data", str(dataset)]
        assert run(evaluate_main, EvaluateConfig, program="evaluate", arguments=arguments) == 0
        scores[name] = json.loads(capsys.readouterr().out)["frames"]
    results = json.loads((trained / "results.json").read_text())["frames"]
    for frame, scored in results.items():
        # the same 8-bit values against the same truth, which the cache keeps in 16 bits
        assert scores["with"][frame]["psnr"] == pytest.approx(scored["psnr"], abs=1e-3)
        assert abs(scores["without"][frame]["psnr"] - scored["psnr"]) > 0.05


def test_the_default_split_is_the_one_that_was_trained(tiny_dataset, tmp_path):
    trained = tmp_path / "run"
    assert train_command(*train_arguments(tiny_dataset, trained, "--split", 0.5)) == 0
    render("--avatar", trained, "--out", tmp_path / "own")
    render("--avatar", trained, "--out", tmp_path / "data", "--data", tiny_dataset)
    own = pictures(tmp_path / "own")
    stored = {frame.name for frame in read_frames(trained) if frame.part == "test"}
    assert set(own) == stored == {"00003_00", "00004_00", "00005_00"}
    assert own == pictures(tmp_path / "data")


def test_a_dataset_without_a_template_is_rendered_with_the_avatars(tiny_dataset, tiny_run, tmp_path):
    """The dataset of an avatar that was trained with --flame; its avatar folder holds the same files."""
    dataset = shutil.copytree(tiny_dataset, tmp_path / "subject")
    (dataset / "template.npz").rename(tmp_path / "flame.npz")
    trained = tmp_path / "run"
    assert train_command(*train_arguments(dataset, trained, "--flame", tmp_path / "flame.npz")) == 0
    (tmp_path / "flame.npz").unlink()
    render("--avatar", trained, "--out", tmp_path / "own")
    render("--avatar", trained, "--out", tmp_path / "data", "--data", dataset)
    assert pictures(tmp_path / "own") == pictures(tmp_path / "data")


def test_an_avatar_that_does_not_say_its_split_takes_the_datasets(tiny_run, tiny_dataset, tmp_path):
    folder = shutil.copytree(tiny_run / "avatar", tmp_path / "avatar")
    description = json.loads((folder / "avatar.json").read_text())
    del description["record"]["split"]
    (folder / "avatar.json").write_text(json.dumps(description))
    render("--avatar", folder, "--out", tmp_path / "out", "--data", tiny_dataset)
    assert set(pictures(tmp_path / "out")) == {"00004_00", "00005_00"}
