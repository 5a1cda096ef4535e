"""The README's commands, run as they are printed and in their order, by a newcomer with an empty home.

The built-in subject that would be made in minutes is a smaller one of the same person, found in the cache,
the preset that would train in minutes is as small, lights are cubes of 64 texels, films have four pictures to
the second, and other people are filmed with few rays: the commands do not know.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest
from subjects import TESTS
from warm_start import warm_python

from samira_subject.plan import VERSION
from samira_warp.io.images import read_image

ROOT = TESTS.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")

NOT_RUN = {
    "pip install -c constraints.txt -e '.[test]' && python -m pytest": "it runs this test",
    "pip install -c constraints.txt -e '.[track]'": "a test does not change its environment",
    "pip install -c constraints.txt -e '.[view]'": "a test does not change its environment",
    "samira-warp view --avatar runs/built_in": "it serves until it is stopped; tests/view runs it",
    "samira-warp train --data VIDEO": "tests/train/test_train_video.py runs it, prepared by a stand-in",
    "samira-warp prepare VIDEO --out DIR": "tests/prepare runs it, with stand-ins for what it calls",
}
"""Commands that are not run here, and why."""

INSTALL = "pip install -c constraints.txt -e . && "
"""What is left out of the first command: the package is there, and a test does not change its environment."""


def commands():
    """Every indented line of the README outside its Python block."""
    text = re.sub(r"^```.*?^```", "", README, flags=re.DOTALL | re.MULTILINE)
    return [line.strip() for line in text.splitlines() if line.startswith("    ")]


def python_block():
    (block,) = re.findall(r"^```python\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)
    return block


SMALLER = """
import functools, sys
from samira_warp.train.config import PRESETS, Preset
PRESETS["cpu"] = Preset(
    resolution=64, uv_size=64, gaussians=3000, gaussian_cap=4000, width=8, region_width=4,
    epochs=10, least_steps=1
)
if "render" in sys.orig_argv:
    from samira_warp.light import Environment
    from samira_warp.render.config import RenderConfig
    Environment.load = functools.partial(Environment.load, size=64)
    RenderConfig.__dataclass_fields__["fps"].default = 4.0
if any(word.endswith("make_subject.py") for word in sys.orig_argv):
    from samira_subject import plan
    from samira_subject.raycaster import Effort
    few = Effort(samples=4, lights=2, lobes=1, more=4, rounds=1)
    plan.SubjectPlan = functools.partial(plan.SubjectPlan, effort=few)
    plan.TEXELS = 128
"""
"""What Python runs before every program of the newcomer's."""


class Newcomer:
    """A shell in a folder that holds what a clone holds, with a home of its own and the package installed."""

    def __init__(self, folder, subject):
        self.folder = folder / "clone"
        self.folder.mkdir()
        for name in ("samira_warp", "samira_subject", "tools", "examples"):
            (self.folder / name).symlink_to(ROOT / name)
        cache = folder / "home" / ".cache" / "samira_warp" / "subject" / f"subject-{VERSION}-seed0"
        shutil.copytree(subject, cache)
        (cache / "dataset.json").write_text(json.dumps({"version": VERSION, "seed": 0}))
        programs = folder / "bin"
        programs.mkdir()
        self.install(programs, [sys.executable])
        (programs / "sitecustomize.py").write_text(SMALLER)
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG", "SAMIRA"))}
        compiled = os.environ.get("WARP_CACHE_PATH") or os.path.expanduser("~/.cache/warp")
        self.environment = kept | {
            "HOME": str(folder / "home"),
            "PATH": f"{programs}:{os.environ['PATH']}",
            "PYTHONPATH": f"{programs}{os.pathsep}{ROOT}",
            "WARP_CACHE_PATH": compiled,
            "HF_HUB_OFFLINE": "1",
        }

    def install(self, programs, python):
        """Programs that start a Python, and the package by it."""
        for name, start in (("python", []), ("samira-warp", ["-m", "samira_warp"])):
            (programs / name).write_text(f'#!/bin/sh\nexec {shlex.join([*python, *start])} "$@"\n')
            (programs / name).chmod(0o755)

    def run(self, command):
        """The command's standard output."""
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        return done.stdout


@pytest.fixture(scope="module")
def newcomer(built_in_datasets, tmp_path_factory):
    """One who has run the first command."""
    newcomer = Newcomer(tmp_path_factory.mktemp("newcomer"), built_in_datasets["VHAP export"])
    (first,) = (command for command in commands() if command.startswith(INSTALL))
    newcomer.run(first.removeprefix(INSTALL))
    newcomer.install(newcomer.folder.parent / "bin", warm_python())  # what follows begins seconds sooner
    return newcomer


def test_the_first_command_makes_an_avatar_and_scores_it(newcomer):
    run = newcomer.folder / "runs" / "built_in"
    assert (run / "avatar" / "avatar.safetensors").is_file()
    assert json.loads((run / "results.json").read_text())["psnr"] > 15


def own_video_commands(data):
    """The commands about one's own video, with a dataset in its place."""
    return [command.replace("DIR/dataset", str(data)) for command in commands() if "DIR/dataset" in command]


def test_every_command_runs_in_its_order(newcomer):
    todo = [
        command
        for command in commands()
        if command not in NOT_RUN and not command.startswith(INSTALL) and "DIR/dataset" not in command
    ]
    assert len(todo) >= 8
    for command in todo:
        newcomer.run(command)
    for command in todo:
        words = shlex.split(command)
        if "--out" in words:
            assert (newcomer.folder / words[words.index("--out") + 1]).exists(), command
    assert {path.name for path in (newcomer.folder / "out").iterdir()} == {
        *("image", "albedo", "normal"),
        *("image.mp4", "albedo.mp4", "normal.mp4"),
    }
    for command in todo:
        if "--env" in shlex.split(command):
            check_light(newcomer, command)


def check_light(newcomer, command):
    """A command that relights is about a light that comes with the package, and its pictures show a head."""
    words = shlex.split(command)
    light, out = (words[words.index(option) + 1] for option in ("--env", "--out"))
    assert (ROOT / light).exists(), command
    picture = read_image(next(iter(sorted((newcomer.folder / out).rglob("*.png")))), channels=3)
    assert picture.std() > 0.05
    assert 0.05 < picture.mean() < 0.95


def test_the_commands_for_ones_own_video_run(newcomer, tiny_dataset, tmp_path):
    """With a made-up dataset in place of the prepared one."""
    data = shutil.copytree(tiny_dataset, tmp_path / "dataset")
    check, train = own_video_commands(data)
    assert "frames" in newcomer.run(check)
    newcomer.run(f"{train} --max-steps 3 --resolution 32 --gaussians 300")
    assert (newcomer.folder / "runs" / "dataset" / "results.json").is_file()


def test_the_example_writes_its_picture(newcomer):
    printed = newcomer.run(f"python -c {shlex.quote(python_block())}")
    assert (newcomer.folder / "relit.png").is_file()
    assert read_image(newcomer.folder / "layers.png", channels=3).std() > 0.05
    assert printed.startswith("torch.Size([")


def test_what_is_not_run_is_there():
    assert set(NOT_RUN) <= set(commands())
