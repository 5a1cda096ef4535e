"""Smooth functions are found once for a head."""

import pytest
import torch
from subjects import small_template

from samira_warp.head.smooth_basis import smooth_basis
from samira_warp.tracker import kept_basis as module
from samira_warp.tracker.kept_basis import FOLDER, kept_basis

COUNT = 5


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path))
    return tmp_path / FOLDER


@pytest.fixture
def found(monkeypatch):
    """How often functions were looked for."""
    calls = []

    def find(template, count):
        calls.append(count)
        return smooth_basis(template, count)

    monkeypatch.setattr(module, "smooth_basis", find)
    return calls


def same(first, second):
    return all((one == other).all() for one, other in zip(first, second, strict=True))


def test_they_are_looked_for_once(cache, found):
    first = kept_basis(small_template(), COUNT)
    assert same(kept_basis(small_template(), COUNT), first)
    assert same(smooth_basis(small_template(), COUNT), first)
    assert found == [COUNT]
    kept_basis(small_template(), COUNT + 1)
    assert found == [COUNT, COUNT + 1]
    assert len(list(cache.iterdir())) == 2


def test_a_damaged_file_is_made_again(cache, found):
    first = kept_basis(small_template(), COUNT)
    (path,) = cache.iterdir()
    for damage in (path.read_bytes()[:100], b"", b"no archive"):
        path.write_bytes(damage)
        assert same(kept_basis(small_template(), COUNT), first)
    assert len(found) == 4
    assert same(kept_basis(small_template(), COUNT), first)
    assert len(found) == 4


def test_without_room_they_are_found_all_the_same(cache, found):
    cache.parent.joinpath(FOLDER).write_bytes(b"a file where the folder would be")
    assert torch.from_numpy(kept_basis(small_template(), COUNT).vectors).isfinite().all()
    assert found == [COUNT]
