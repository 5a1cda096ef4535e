"""``glb`` in programs of others, from npm: three.js in a browser, and Khronos' validator."""

import json
import shutil
import subprocess
import tarfile

import pytest
from chromium import CHROMIUM
from subjects import TESTS

from samira_warp.avatar import Avatar, read_frames
from samira_warp.export.__main__ import command

THREE, VALIDATOR = "three@0.187.0", "gltf-validator@2.0.0-dev.3.10"

VALIDATE = """
const {readFileSync} = require("fs"), {validateBytes} = require(process.argv[1]);
validateBytes(new Uint8Array(readFileSync(process.argv[2])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""


@pytest.fixture(scope="module")
def from_npm(made_once):
    """``from_npm(package)`` is the folder of a package; the test is skipped where it cannot be had."""

    def unpacked(package):
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip(f"no npm on this machine, for {package}")

        def make(folder):
            folder.mkdir()
            words = [npm, "pack", package, "--pack-destination", str(folder)]
            subprocess.run(words, timeout=300, check=True, capture_output=True)
            (archive,) = folder.glob("*.tgz")
            with tarfile.open(archive) as file:
                file.extractall(folder, filter="data")

        try:
            return made_once(package, make) / "package"
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            pytest.skip(f"npm cannot get {package}")

    return unpacked


@pytest.fixture(scope="module")
def glb(saved, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "head.glb"
    options = ["--format", "glb", "--texture-size", "128", "--out", str(path)]
    assert command(["--avatar", str(saved), *options]) == 0
    return path


def test_the_validator_has_nothing_to_say(glb, from_npm):
    folder = from_npm(VALIDATOR)
    words = ["node", "-e", VALIDATE, str(folder), str(glb)]
    done = subprocess.run(words, timeout=300, check=True, capture_output=True, text=True)
    assert json.loads(done.stdout)["messages"] == []


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_three_shows_the_avatar(glb, saved, from_npm, monkeypatch):
    """Every frame of the animation beside the avatar's own albedo, and under a light of 1 from everywhere."""
    monkeypatch.syspath_prepend(TESTS.parent / "tools")
    from export_pictures import browser_pictures, own_pictures, score

    three = from_npm(THREE)
    frames = dict(enumerate(frame for frame in read_frames(saved) if frame.part == "test"))
    pictures = browser_pictures(glb, frames, three=three)
    avatar = Avatar.load(saved)
    found = {
        name: score(pictures[name], own_pictures(avatar, frames, name, albedo=False))
        for name in ("albedo", "white")
    }
    # 48 pixels of Gaussians that are two of them wide, about a ball of facets
    assert found["albedo"]["psnr_covered"] > 20.0, found
    assert found["white"]["psnr_covered"] > 17.0, found
    other = {number: pictures["albedo"][1 - number] for number in frames}
    moved = score(other, own_pictures(avatar, frames, "albedo", albedo=False))
    assert moved["psnr"] < found["albedo"]["psnr"] - 1.0
