"""A wheel and an sdist as a user gets them: built, installed in an environment of its own, and run."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import samira_warp

ROOT = Path(__file__).parents[1]
PACKAGES = ("samira_warp", "samira_subject")


def done(*command, **options):
    ended = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, timeout=300, check=False, **options
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The folder of an sdist and of a wheel that was built from it, off a copy: builds leave files behind."""
    folder = tmp_path_factory.mktemp("package")
    left_out = shutil.ignore_patterns(".*", "runs", "build", "dist", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, folder / "source", ignore=left_out)
    done(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", folder / "source")
    return folder / "dist"


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """Run a command of an environment that has the wheel, in a folder of its own, and give what it prints.

    Dependencies are this environment's: its folder is on the path, and the files in it that lead to the
    repository are not read.
    """
    environment = tmp_path_factory.mktemp("environment")
    venv.create(environment, with_pip=False)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    (wheel,) = built.glob("*.whl")
    pip = (sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check")
    done(*pip, "install", "--quiet", "--no-deps", "--no-index", wheel)
    packages = done(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    Path(packages, "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    elsewhere = tmp_path_factory.mktemp("elsewhere")

    def run(name, *arguments):
        return done(python.with_name(name), *arguments, cwd=elsewhere, env=variables)

    return run


def sources():
    return {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }


def test_the_wheel_holds_the_packages_and_nothing_else(built):
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    information = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    assert names - information == sources()
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert any(name.endswith("/licenses/LICENSE") for name in information)
    assert wheel.name.startswith(f"samira_warp-{samira_warp.__version__}-py3-none-any")


def test_the_sdist_holds_what_building_needs(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert sources() | {"pyproject.toml", "README.md", "LICENSE"} <= names
    assert not [name for name in names if name.startswith(("tests", "docs", "tools", "runs"))]


def test_the_installed_command_runs_anywhere(installed, tiny_run, tmp_path):
    assert installed("samira-warp", "--version") == f"samira-warp {samira_warp.__version__}\n"
    assert installed("samira-warp", "train", "--help").startswith("usage: samira-warp train ")
    script = "import samira_subject, samira_warp; print(samira_subject.__file__, samira_warp.__file__)"
    places = installed("python", "-c", script).split()
    assert not [place for place in places if Path(place).is_relative_to(ROOT)]
    # kernels are compiled from the installed sources
    installed("samira-warp", "render", "--avatar", tiny_run, "--out", tmp_path / "out", "--device", "cpu")
    assert len(list((tmp_path / "out" / "image").glob("*.png"))) == 2
