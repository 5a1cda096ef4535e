"""The view verb from outside: what it refuses, in one line, and how it ends."""

import json
import shutil
import signal
import socket
import subprocess
import urllib.request

import pytest
import torch
from warm_start import warm_python

from samira_warp.__main__ import main
from samira_warp.avatar.storage import find_avatar
from samira_warp.avatar.storage.older import READABLE
from samira_warp.view.following import Follower, Progress
from samira_warp.view.runs import newest_avatar


def refused(capsys, *words):
    assert main(["view", *map(str, words)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    return line


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "--avatar: expected it or --run, one of them, found neither"),
        (["--avatar", "a", "--run", "b"], "--avatar: expected it or --run, one of them, found both"),
        (["--avatar", "a", "--port", "70000"], "--port: expected 0 to 65535"),
        (["--avatar", "a", "--resolution", "10"], "--resolution: expected 256 to 2048 pixels"),
        (["--avatar", "a", "--split", "train"], "--split: expected --data with it"),
        (
            ["--avatar", "none", "--port", "0"],
            "none: expected an avatar or a finished run, found no such folder",
        ),
        (["--run", "none", "--port", "0"], "none: expected a run folder, found no config.json in it"),
    ],
)
def test_options_that_do_not_go_together(capsys, words, complaint):
    assert refused(capsys, *words).startswith(f"error: {complaint}")


def test_a_folder_without_maps(capsys, tmp_path):
    words = ("--avatar", "none", "--port", 0, "--envs")
    assert refused(capsys, *words, tmp_path).startswith(f"error: {tmp_path}: expected environment maps")
    gone = tmp_path / "gone"
    assert (
        refused(capsys, *words, gone)
        == f"error: {gone}: expected a folder of environment maps, found no such folder"
    )


def test_an_avatar_of_another_version_says_which_are_read(capsys, tiny_run, tmp_path):
    copy = shutil.copytree(find_avatar(tiny_run), tmp_path / "avatar")
    description = json.loads((copy / "avatar.json").read_text())
    (copy / "avatar.json").write_text(json.dumps({**description, "format": 99}))
    line = refused(capsys, "--avatar", copy, "--port", 0)
    read = f"an avatar of format {READABLE[0]} to {READABLE[-1]}"
    assert f"expected {read}, found format 99, which a newer version" in line


def test_a_port_in_use(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = refused(capsys, "--avatar", "none", "--host", "127.0.0.1", "--port", port)
    assert line.startswith(f"error: 127.0.0.1:{port}: expected a port that is free here, found ")


def test_without_the_library_the_extra_is_named(capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    line = refused(capsys, "--avatar", "none")
    assert line == "error: viser: expected what serves the page (pip install 'samira-warp[view]'), found none"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_it_serves_until_it_is_told_to_end(tiny_run, number):
    words = ["-m", "samira_warp.view", "--avatar", str(tiny_run), "--host", "127.0.0.1", "--port", "0"]
    process = subprocess.Popen(
        [*warm_python(), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        line = process.stderr.readline()
        address = line.split()[0]
        assert line == f"{address} shows {find_avatar(tiny_run)}; Ctrl-C ends it\n"
        assert b"<html" in urllib.request.urlopen(address, timeout=30).read()
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
    assert (process.returncode, out, err) == (0, "", "")


@pytest.fixture
def run(tiny_run, tmp_path):
    """A run folder as it is amid a training: a checkpoint, a line that is being written, no avatar."""
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder, ignore=shutil.ignore_patterns("avatar", "preview", "events*"))
    assert (folder / "checkpoints").is_dir()
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"step": 999, "lo')
    return folder


def test_a_run_without_a_checkpoint_yet(capsys, run):
    shutil.rmtree(run / "checkpoints")
    assert "expected a first checkpoint to show, found none yet" in refused(capsys, "--run", run, "--port", 0)


def test_a_run_is_followed(run, tiny_run):
    first = newest_avatar(run)
    assert first.parent.name == "checkpoints"
    follower = Follower(run, first, device=torch.device("cpu"))
    avatars, progress = [], []

    def look():
        follower.look(on_avatar=lambda avatar, folder: avatars.append(folder), on_progress=progress.append)

    look()
    assert (avatars, progress) == ([], [])
    later = first.with_name("step_000998")
    shutil.copytree(first, later)
    look()
    assert avatars == [later]
    assert progress[-1].shown == "step_000998"
    with (run / "metrics.jsonl").open("a") as file:
        file.write('ss": 0.25}\n')
    look()
    assert progress[-1].lines[-1] == {"step": 999, "loss": 0.25}
    assert progress[-1].curve("loss")[0][-1] == 999
    shutil.copytree(tiny_run / "avatar", run / "avatar")
    look()
    assert avatars == [later, run / "avatar"]


def test_a_checkpoint_is_moved_by_the_runs_own_frames(run, tiny_run):
    from samira_warp.avatar import read_frames
    from samira_warp.view.config import ViewConfig
    from samira_warp.view.sources import load_shown

    shown = load_shown(ViewConfig(run=run), torch.device("cpu"))
    own = sorted(read_frames(tiny_run), key=lambda frame: frame.name)
    assert [(frame.name, frame.part) for frame in shown.poser.frames] == [
        (frame.name, frame.part) for frame in own
    ]


def test_a_run_that_has_logged_nothing_has_curves_of_nothing(run):
    (run / "metrics.jsonl").unlink()
    progress = Progress.read(run, shown=run)
    assert progress.lines == ()
    assert [values.tolist() for values in progress.curve("psnr")] == [[0.0], [0.0]]
    assert progress.words().startswith("**Step 0 of ")


def test_the_page_is_there_soon_after_an_ended_one():
    """A port that has just been served is free again."""
    from samira_warp.view.ports import free_port

    with socket.socket() as served:
        served.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        served.bind(("127.0.0.1", 0))
        served.listen()
        port = served.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as client:
            accepted, _ = served.accept()
            accepted.close()  # this side waits for late packets from now on
            client.recv(1)
    assert free_port("127.0.0.1", port) == port
