"""Fixtures: the devices of this machine, the real subject, and a seeded generator."""

import os
import shutil
import subprocess
from pathlib import Path

os.environ.setdefault("PYTHONHASHSEED", "0")

import pytest
import torch
import warp
from filelock import FileLock

# tests read standard error: in this process nothing is said of compiling kernels
warp.config.log_level = warp.LOG_WARNING

WORKER = "PYTEST_XDIST_WORKER" in os.environ
"""Whether this is one of several processes of pytest-xdist."""

SUBJECT = Path(__file__).resolve().parents[2] / "shared" / "data" / "heads" / "ict_a"

LONG_FILES = (
    "test_browser.py",
    "test_own_tracker.py",
    "test_readme.py",
    "test_hard_films.py",
    "test_resume.py",
    "test_make.py",
    "test_command.py",
    "test_prepare.py",
    "test_ranks.py",
    "test_fleet.py",
    "test_examples.py",
    "test_loading.py",
    "test_relighting.py",
    "test_occlusion.py",
    "test_blending_cuda.py",
    "test_view_scene.py",
    "test_follow_faces.py",
)
"""What workers begin with, so that none is left with one of these at the end."""

THREADS = torch.get_num_threads()
"""Torch's before any test. Runs that are compared to the bit, some made by processes of their own, need as
many."""

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes():
    """Workers that are about to start have one thread each, unless told otherwise."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Workers (``-n 2``) take whole files, whose tests share what is costly, in the order of collection."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


def pytest_collection_modifyitems(items):
    if WORKER:
        ranks = {name: rank for rank, name in enumerate(LONG_FILES)}
        items.sort(key=lambda item: ranks.get(item.path.name, len(ranks)))


@pytest.fixture(params=DEVICES)
def device(request):
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    return torch.device(request.param)


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture
def use_threads():
    """`torch.set_num_threads`, taken back after the test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def _kept_threads():
    """A test, or what it loads, leaves torch the threads that it had."""
    yield
    threads = torch.get_num_threads()
    if threads != THREADS:
        torch.set_num_threads(THREADS)
    assert threads == THREADS


@pytest.fixture
def subject():
    if not SUBJECT.is_dir():
        pytest.skip(f"the real subject is absent: {SUBJECT.name} is not part of the project")
    return SUBJECT


@pytest.fixture(scope="session")
def common_folder(tmp_path_factory):
    """A folder of this session, the same in all of its workers where pytest-xdist runs several."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if WORKER else own) / "common"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def made_once(common_folder):
    """``made_once(name, make)`` is a folder that ``make`` has filled, in the first of the workers to ask."""

    def made(name, make):
        folder, whole = common_folder / name, common_folder / f"{name}.whole"
        with FileLock(common_folder / f"{name}.lock"):
            if not whole.exists():
                shutil.rmtree(folder, ignore_errors=True)
                make(folder)
                whole.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def tiny_dataset(made_once):
    """A made-up subject of six frames of 32 x 32 pixels, four of which train. Tests that change it copy it
    first."""
    from data.tiny import make_tiny_dataset

    return made_once("subject", make_tiny_dataset)


def trained_on(dataset):
    """Makes the finished run of `subjects.STEPS` steps on a dataset."""
    from subjects import train_arguments
    from warm_start import warm_python

    def make(folder):
        program = Path(__file__).with_name("subjects.py")
        command = [*warm_python(), str(program), *map(str, train_arguments(dataset, folder))]
        assert subprocess.run(command, timeout=600, check=False).returncode == 0

    return make


@pytest.fixture(scope="session")
def tiny_run(tiny_dataset, made_once):
    """The finished run on `tiny_dataset`."""
    return made_once("tiny run", trained_on(tiny_dataset))


@pytest.fixture(scope="session")
def stand_in_dataset(made_once):
    """What is made of a subject, of a made-up sphere with eyes instead: truth, relit frames, orbit.

    Tests that change it copy it first.
    """
    from subject.stand_in import PLAN, stand_in

    from samira_subject.make import make_subject
    from samira_subject.studio import threads

    def make(folder):
        with threads(2):
            make_subject(folder, PLAN, stand_in)

    return made_once("stand-in", make)


@pytest.fixture(scope="session")
def built_in_datasets(made_once):
    """Folders of the built-in subject's film in every layout, by its name; the first five of eight frames of
    64 x 64 pixels train.

    Tests that change one copy it first.
    """
    from data.built_in import built_in_film, write_built_in
    from data.layouts import WRITERS

    folder = made_once("built in", lambda folder: write_built_in(folder, built_in_film(0)))
    return {layout: folder / layout for layout in WRITERS}


@pytest.fixture(scope="session")
def built_in_run(built_in_datasets, made_once):
    """The finished run on the built-in subject."""
    return made_once("built in run", trained_on(built_in_datasets["VHAP export"]))


@pytest.fixture(scope="session", autouse=True)
def _no_power_cut():
    """Files are written as ever, and the disk is not waited for: for a file of a kilobyte that takes longer
    than all else. A process that is killed leaves what it had written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _own_cache(common_folder):
    """Tests keep nothing in the user's cache folder, nor find anything there; processes that they start share
    theirs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SAMIRA_WARP_CACHE", str(common_folder / "cache"))
        yield
