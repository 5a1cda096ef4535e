"""Mistakes of a user of ``samira-warp export``, in processes of their own: one line, status 2, no file."""

import json
import os
import shutil
import subprocess
import sys

import pytest
from warm_start import warm_python

from samira_warp.avatar.storage.older import READABLE

BLOCKED = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {names}:
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Missing())
"""


@pytest.fixture
def place(tiny_run, tmp_path):
    """A folder to work in, with the avatar and with what is none."""
    shutil.copytree(tiny_run / "avatar", tmp_path / "newer")
    description = tmp_path / "newer" / "avatar.json"
    values = json.loads(description.read_text())
    description.write_text(json.dumps({**values, "format": 99}))
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n\0\0")
    (tmp_path / "blocked").mkdir()
    names = {"zstandard", "pxr"}
    (tmp_path / "blocked" / "sitecustomize.py").write_text(BLOCKED.format(names=names))
    return tmp_path


def export(place, *words, blocked=False):
    """The command's status, and its lines on standard error."""
    path = [str(place / "blocked")] if blocked else []
    path += [each for each in os.environ.get("PYTHONPATH", "").split(os.pathsep) if each]
    # a warm process has loaded what is blocked
    python = [sys.executable] if blocked else warm_python()
    done = subprocess.run(
        [*python, "-m", "samira_warp", "export", *map(str, words)],
        cwd=place,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout == ""
    return done.returncode, done.stderr.splitlines()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--avatar", "newer", "--out", "a.spz"],
            f"format 1 to {READABLE[-1]}, found format 99, which a newer version",
        ),
        (["--avatar", "empty", "--out", "a.glb", "--format", "gltf-splats"], "expected an avatar or a fini"),
        (["--avatar", "none", "--out", "a.usdc"], "none: expected an avatar or a finished run"),
        (["--avatar", "RUN", "--out", "a.ply", "--env", "broken.hdr"], "broken.hdr"),
        (["--avatar", "RUN", "--out", "a.ply", "--env", "empty"], "empty: expected a learned light"),
        (["--avatar", "RUN", "--out", "empty", "--format", "usd"], "empty: expected a file name ending in"),
        (["--avatar", "RUN", "--out", "there/a.ply"], "there: expected an existing folder"),
    ],
    ids=["version", "no avatar", "nothing", "broken light", "no light", "folder", "no folder"],
)
def test_mistakes(place, tiny_run, words, said):
    before = sorted(place.rglob("*"))
    status, lines = export(place, *(tiny_run if word == "RUN" else word for word in words))
    assert status == 2
    (line,) = lines
    assert said in line
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (["--out", "a.usdz"], "usd-core", "usd"),
        (["--out", "a.spz", "--spz-version", "4"], "zstandard", "spz"),
    ],
    ids=["usd", "spz"],
)
def test_a_library_that_is_not_installed_is_named_with_its_command(place, tiny_run, words, package, extra):
    before = sorted(place.rglob("*"))
    status, lines = export(place, "--avatar", tiny_run, *words, blocked=True)
    assert (status, len(lines)) == (2, 1)
    assert f"expected {package} (pip install 'samira-warp[{extra}]'), found it is not installed" in lines[0]
    assert sorted(each for each in place.rglob("*") if "__pycache__" not in each.parts) == before


def test_the_spz_of_most_readers_needs_no_library(place, tiny_run):
    status, lines = export(place, "--avatar", tiny_run, "--albedo", "--out", "a.spz", blocked=True)
    assert status == 0
    assert lines[-1].startswith("a.spz: ")
    assert lines[-1].endswith(", version 2")
    assert (place / "a.spz").stat().st_size > 0
