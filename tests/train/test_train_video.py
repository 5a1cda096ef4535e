"""Training on a video: prepared in the run folder, then trained on. What prepares is a stand-in here."""

import json
import shutil

import pytest
from data.tiny import make_tiny_dataset
from subjects import STEPS, train_arguments, train_command

from samira_warp.avatar import Avatar
from samira_warp.prepare import run as prepare_run
from samira_warp.support.errors import UserError


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "films" / "me.mp4"
    path.parent.mkdir()
    path.write_bytes(b"film")
    return path


class StandIn:
    """Prepares the made-up subject for any video; keeps how it was asked, and fails as it is told to."""

    def __init__(self):
        self.asked, self.fails = [], None

    def __call__(self, config):
        self.asked.append(config)
        if self.fails is not None:
            raise self.fails
        if not (config.out / "dataset").exists():
            make_tiny_dataset(config.out / "dataset")
        return config.out / "dataset"


@pytest.fixture
def preparing(monkeypatch):
    stand_in = StandIn()
    monkeypatch.setattr(prepare_run, "prepare", stand_in)
    return stand_in


def test_a_video_is_prepared_in_the_run_folder_and_trained_on(video, preparing, tmp_path):
    run = tmp_path / "run"
    assert train_command(*train_arguments(video, run)) == 0
    (asked,) = preparing.asked
    assert (asked.video, asked.out) == (video, run / "prepared")
    Avatar.load(run)
    assert json.loads((run / "config.json").read_text())["settings"]["data"] == str(
        run / "prepared" / "dataset"
    )


def test_a_run_is_named_after_its_video(video, preparing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert train_command("--data", video, *train_arguments("", "")[4:]) == 0
    Avatar.load(tmp_path / "runs" / "me")


def test_what_cannot_be_prepared_is_told_in_a_line_and_leaves_nothing(video, preparing, tmp_path, capsys):
    preparing.fails = UserError(video, expected="a face", found="none in it")
    assert train_command(*train_arguments(video, tmp_path / "run")) == 2
    assert capsys.readouterr().err == f"error: {video}: expected a face, found none in it\n"
    assert not (tmp_path / "run").exists()


def test_options_are_checked_before_anything_is_prepared(video, preparing, tmp_path):
    assert train_command(*train_arguments(video, tmp_path / "run", "--resolution", 2)) == 2
    assert train_command(*train_arguments(video, tmp_path / "run", "--device", "cuda:99")) == 2
    assert not preparing.asked


@pytest.mark.parametrize("more", [(), ("--resume",)])
def test_an_interrupted_preparation_goes_on_with_the_same_command(video, preparing, tmp_path, capsys, more):
    run = tmp_path / "run"
    preparing.fails = KeyboardInterrupt()
    assert train_command(*train_arguments(video, run)) == 130
    assert "stopped before the first step; the same command goes on" in capsys.readouterr().err
    preparing.fails = None
    (run / "prepared").mkdir(parents=True, exist_ok=True)
    assert train_command(*train_arguments(video, run, *more)) == 0
    assert [asked.out for asked in preparing.asked] == 2 * [run / "prepared"]


@pytest.mark.parametrize("by_name", [True, False])
def test_a_run_on_a_video_is_extended(video, preparing, tmp_path, by_name):
    run = tmp_path / "run"
    assert train_command(*train_arguments(video, run)) == 0
    shutil.rmtree(run / "avatar")
    if by_name:
        arguments = train_arguments(video, run, "--resume", "--max-steps", STEPS + 1)
    else:
        video.unlink()
        arguments = ["--out", run, "--resume", "--max-steps", STEPS + 1]
    assert train_command(*arguments) == 0
    assert json.loads((run / "config.json").read_text())["steps"] == STEPS + 1
    assert len(preparing.asked) == (2 if by_name else 1)
