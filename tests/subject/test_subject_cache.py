"""Where the built-in subject is kept: made once, by one process, and never in the place of what is somebody's
own."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock
from subjects import train_command
from warm_start import warm_python

from samira_subject import cache
from samira_subject.plan import VERSION
from samira_warp import UserError

HOLDER = """
import sys
from pathlib import Path
from filelock import FileLock
folder = Path(sys.argv[1])
with FileLock(folder.parent / f".{folder.name}.lock"):
    print("held", flush=True)
    sys.stdin.read()
    folder.mkdir()
    (folder / "dataset.json").write_text(sys.argv[2])
"""
"""A process that makes a subject until its standard input ends."""


def facts(*, version=VERSION, seed=0):
    return json.dumps({"version": version, "seed": seed})


def write_facts(folder, text):
    folder.mkdir(parents=True)
    (folder / "dataset.json").write_text(text)


@pytest.fixture(autouse=True)
def _empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def made(monkeypatch):
    """Seeds of the subjects made: of each no more than what it says of itself."""
    seeds = []

    def make(folder, plan, cast):
        assert cast() == "a cast"
        seeds.append(plan.seed)
        shutil.rmtree(folder, ignore_errors=True)
        write_facts(folder, facts(seed=plan.seed))

    monkeypatch.setattr(cache, "make_subject", make)
    monkeypatch.setattr(cache, "build_cast", lambda seed: "a cast")
    return seeds


@pytest.fixture
def holder():
    """Starts another process that makes a subject, in a folder."""
    started = []

    def start(folder):
        folder.parent.mkdir(parents=True)
        command = [*warm_python(), "-c", HOLDER, str(folder), facts()]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            pipe.close()


def test_it_is_made_once_and_said_where(made, capsys):
    assert cache.built_in_subject(7) == cache.built_in_subject(7) == cache.subject_folder(7)
    assert made == [7]
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"making the built-in subject, once, in {cache.subject_folder(7)}"


@pytest.mark.parametrize("found", [None, "{", "[]", facts(version=VERSION + 1), facts(seed=1)])
def test_what_is_not_whole_or_another_one_is_made_again(made, capsys, found):
    folder = cache.subject_folder()
    if found is None:
        folder.mkdir(parents=True)
    else:
        write_facts(folder, found)
    assert cache.built_in_subject() == cache.built_in_subject() == folder
    assert made == [0]
    (line,) = capsys.readouterr().err.splitlines()
    assert str(folder) in line
    assert "making it again" in line


def test_a_file_in_its_place_is_left_alone(made):
    folder = cache.subject_folder()
    folder.parent.mkdir(parents=True)
    folder.write_text("mine")
    with pytest.raises(UserError, match=f"{folder}: .*SAMIRA_WARP_CACHE.*found a file"):
        cache.built_in_subject()
    assert folder.read_text() == "mine"
    folder.unlink()
    folder.symlink_to("nowhere")
    with pytest.raises(UserError, match="found a broken link"):
        cache.built_in_subject()
    assert folder.is_symlink()
    assert made == []


def refused(capsys):
    """The one line about a cache that cannot be written."""
    assert train_command("--preset", "cpu", "--device", "cpu", "--encoder", "random") == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"error: {cache.subject_folder()}: expected ")
    assert "SAMIRA_WARP_CACHE names another" in line
    return line


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="every folder can be written by this user"
)
def test_a_cache_that_cannot_be_written_is_said_with_the_remedy(tmp_path, made, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cache").mkdir(mode=0o500)
    assert "Permission denied" in refused(capsys)
    assert made == []


def test_a_cache_that_is_a_file_is_said_with_the_remedy(tmp_path, made, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cache").write_text("mine")
    assert refused(capsys)
    assert made == []
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


def test_a_full_disk_is_said_with_the_remedy(tmp_path, made, monkeypatch, capsys):
    def fail(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cache, "make_subject", fail)
    assert "No space left" in refused(capsys)


def test_a_file_system_without_locks_is_said_with_the_remedy(tmp_path, made, monkeypatch, capsys):
    def fail(*arguments, **options):
        raise NotImplementedError("no flock")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(FileLock, "acquire", fail)
    assert "locks" in refused(capsys)
    assert made == []


def test_what_another_process_makes_is_waited_for(made, holder, monkeypatch):
    folder = cache.subject_folder()
    other = holder(folder)

    class Listener(io.StringIO):
        """Lets the other process finish once it is said that it is waited for."""

        def write(self, text):
            if "waiting" in text:
                other.stdin.close()
            return super().write(text)

    monkeypatch.setattr(sys, "stderr", Listener())
    assert cache.built_in_subject() == folder
    assert sys.stderr.getvalue() == f"another process is making the built-in subject in {folder}; waiting\n"
    assert made == []


def test_ctrl_c_ends_the_wait(holder, tmp_path):
    folder = cache.subject_folder()
    holder(folder)
    command = [*warm_python(), "-m", "samira_warp.train", "--device", "cpu"]
    waiting = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    said = []
    for line in waiting.stderr:
        said.append(line)
        if "waiting" in line:
            waiting.send_signal(signal.SIGINT)
    assert waiting.wait(timeout=60) == 130, said
    assert said[-1].strip().endswith("waiting")
    assert not folder.exists()
    assert not (tmp_path / "runs").exists()


def test_train_takes_the_subject_that_is_there(tiny_dataset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = cache.subject_folder()
    shutil.copytree(tiny_dataset, folder)
    (folder / "dataset.json").write_text(facts())
    assert train_command("--preset", "cpu", "--device", "cpu", "--encoder", "random", "--max-steps", "2") == 0
    assert capsys.readouterr().err.count(f"no --data: the built-in subject, in {folder}\n") == 1
    run = Path("runs") / "built_in"
    assert json.loads((run / "config.json").read_text())["settings"]["data"] == str(folder)
    assert (run / "results.json").is_file()


def test_a_run_on_the_subject_goes_on_where_it_is_kept_by_then(tiny_dataset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = ("--preset", "cpu", "--device", "cpu", "--encoder", "random", "--max-steps", "2")
    before = cache.subject_folder()
    shutil.copytree(tiny_dataset, before)
    (before / "dataset.json").write_text(facts())
    assert train_command(*options) == 0
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "elsewhere"))
    folder = cache.subject_folder()
    folder.parent.mkdir(parents=True)
    before.rename(folder)
    capsys.readouterr()
    assert train_command("--resume") == 0
    assert f"no --data: the built-in subject, in {folder}\n" in capsys.readouterr().err
