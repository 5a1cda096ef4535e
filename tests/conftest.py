"""Fixtures: the devices of this machine, the real subject, and a seeded generator."""

import os
from pathlib import Path

os.environ.setdefault("PYTHONHASHSEED", "0")

import pytest
import torch
import warp

# tests read standard error: in this process nothing is said of compiling kernels
warp.config.log_level = warp.LOG_WARNING

SUBJECT = Path(__file__).resolve().parents[2] / "shared" / "data" / "heads" / "ict_a"

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


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


@pytest.fixture
def subject():
    if not SUBJECT.is_dir():
        pytest.skip(f"the real subject is absent: {SUBJECT.name} is not part of the project")
    return SUBJECT


@pytest.fixture(scope="session")
def tiny_dataset(tmp_path_factory):
    """A made-up subject of six frames of 32 x 32 pixels, four of which train. Tests that change it copy it
    first."""
    from data.tiny import make_tiny_dataset

    return make_tiny_dataset(tmp_path_factory.mktemp("tiny") / "subject")


@pytest.fixture(scope="session")
def tiny_run(tiny_dataset, tmp_path_factory):
    """The finished run of `subjects.STEPS` steps on `tiny_dataset`."""
    from subjects import train_arguments, train_command

    folder = tmp_path_factory.mktemp("run") / "out"
    assert train_command(*train_arguments(tiny_dataset, folder)) == 0
    return folder


@pytest.fixture(scope="session")
def built_in_datasets(tmp_path_factory):
    """Folders of the built-in subject's film in every layout, by its name; the first five of eight frames of
    64 x 64 pixels train.

    Tests that change one copy it first.
    """
    from data.built_in import built_in_film, write_built_in

    return write_built_in(tmp_path_factory.mktemp("built in"), built_in_film(0))


@pytest.fixture(scope="session")
def built_in_run(built_in_datasets, tmp_path_factory):
    """The finished run of `subjects.STEPS` steps on the built-in subject."""
    from subjects import train_arguments, train_command

    folder = tmp_path_factory.mktemp("run") / "out"
    assert train_command(*train_arguments(built_in_datasets["VHAP export"], folder)) == 0
    return folder


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    """Tests keep nothing in the user's cache folder, nor find anything there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SAMIRA_WARP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
