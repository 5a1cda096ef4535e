"""Long sequences: what was read of their files is read once, believed only while the files are the same, and
never too much at a time."""

import json
import os
import shutil
import sys
import tracemalloc
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch
from data.damage import change_arrays
from data.layouts import make_film, make_film_for, write_layout
from data.tiny import tiny_template

from samira_warp.data import (
    PixelCache,
    index,
    metrical_tracker,
    open_listing,
    open_sequence,
    vhap_parameters,
)
from samira_warp.data.index import FileIndex
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.io.files import cache_folder
from samira_warp.io.images import image_size
from samira_warp.support.errors import UserError

LAYOUTS = ("VHAP export", "metrical-tracker")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """An empty cache folder, in which even a short sequence is kept."""
    monkeypatch.setenv("SAMIRA_WARP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(index, "FEWEST_FILES", 1)
    return tmp_path / "cache" / "index"


@pytest.fixture
def reads(monkeypatch):
    """Names of the files that were read rather than remembered."""
    names = []

    def counted(path):
        names.append(path.name)
        return image_size(path)

    monkeypatch.setattr(index, "image_size", counted)
    return names


def dataset(layout, root, **options):
    film = make_film_for(layout, **options)
    if layout == "VHAP export":
        film.static_offset = 1e-3 * np.random.default_rng(0).normal(
            size=(len(tiny_template()["v_template"]), 3)
        )
    write_layout(layout, film, root)
    np.savez(root / "template.npz", **tiny_template())
    return root


def assert_same(first, second):
    assert (first.train, first.test, first.notes) == (second.train, second.test, second.notes)
    for ours, theirs in zip(first.frames, second.frames, strict=True):
        assert (ours.name, ours.image_path, ours.mask_path) == (
            theirs.name,
            theirs.image_path,
            theirs.mask_path,
        )
        assert torch.equal(ours.camera.world_to_camera, theirs.camera.world_to_camera)
        for field in fields(ours.parameters):
            a, b = getattr(ours.parameters, field.name), getattr(theirs.parameters, field.name)
            assert (a is None and b is None) or torch.equal(a, b)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_second_opening_reads_nothing_and_gives_the_same(tmp_path, cache, reads, layout, monkeypatch):
    root = dataset(layout, tmp_path / "subject")
    first = open_sequence(root)
    assert len(reads) == len(first.frames) * (2 if layout == "VHAP export" else 1)
    assert len(list(cache.iterdir())) == 1
    reads.clear()
    load = vhap_parameters.load_parameters

    def refuse(path):
        assert path.name == CANONICAL_FILE, f"{path} is read again"
        return load(path)

    monkeypatch.setattr(vhap_parameters, "load_parameters", refuse)
    monkeypatch.setattr(metrical_tracker, "_read_frame", refuse)
    assert_same(open_sequence(root), first)
    assert reads == []


def test_a_folder_by_another_name_is_the_same(tmp_path, cache, reads, monkeypatch):
    root = dataset("VHAP export", tmp_path / "subject")
    first = open_sequence(root)
    reads.clear()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(root)
    for other in ("subject", "link", "./subject/../subject"):
        assert len(open_sequence(Path(other)).frames) == len(first.frames)
    assert reads == []
    assert len(list(cache.iterdir())) == 1


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_changed_file_is_read_again(tmp_path, reads, layout):
    root = dataset(layout, tmp_path / "subject")
    before = open_sequence(root)
    reads.clear()
    if layout == "VHAP export":
        change_arrays(root / "flame_param" / "00002.npz", rotation=lambda array: array + 1)
    else:
        os.utime(root / "images" / "00002.png")
        (root / "checkpoint" / "00002.frame").write_bytes(b"PK")
        with pytest.raises(UserError, match=r"00002\.frame"):
            open_sequence(root)
        return
    os.utime(root / "images" / "00002.png")
    after = open_sequence(root)
    assert reads == ["00002.png"]
    turned = torch.tensor([1.0, 0.0, 0.0, 0.0, 0.0])[:, None]  # the root alone
    assert torch.equal(after.frames[2].parameters.rotations, before.frames[2].parameters.rotations + turned)
    assert torch.equal(after.frames[3].parameters.rotations, before.frames[3].parameters.rotations)


def test_a_file_that_is_gone_is_missed(tmp_path):
    root = dataset("VHAP export", tmp_path / "subject")
    open_sequence(root)
    (root / "flame_param" / "00003.npz").unlink()
    with pytest.raises(UserError, match=r"00003\.npz.*no such file"):
        open_sequence(root)


def test_faults_are_found_on_every_opening(tmp_path):
    root = dataset("VHAP export", tmp_path / "subject")
    change_arrays(root / "flame_param" / "00001.npz", expr=lambda array: array * np.nan)
    for _ in range(2):
        with pytest.raises(UserError, match=r"00001\.npz: expr: expected finite numbers, found 4"):
            open_sequence(root)
        open_listing(root)  # keeps what it has seen


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x05\x06" + bytes(18), None])
def test_a_broken_index_counts_as_none(tmp_path, cache, reads, content):
    root = dataset("metrical-tracker", tmp_path / "subject")
    first = open_sequence(root)
    (path,) = cache.iterdir()
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    reads.clear()
    assert_same(open_sequence(root), first)
    assert len(reads) == len(first.frames)


def test_an_index_of_another_version_counts_as_none(tmp_path, reads, monkeypatch):
    root = dataset("metrical-tracker", tmp_path / "subject")
    open_sequence(root)
    monkeypatch.setattr(index, "_VERSION", index._VERSION + 1)
    reads.clear()
    open_sequence(root)
    assert reads


def test_a_cache_folder_that_cannot_be_made_is_done_without(tmp_path, cache):
    cache.parent.write_text("a file where the folder should be")
    root = dataset("VHAP export", tmp_path / "subject")
    assert len(open_sequence(root).frames) == 6


def test_two_folders_have_two_indices(tmp_path, cache):
    for name in ("a", "b"):
        open_sequence(dataset("VHAP export", tmp_path / name))
    assert len(list(cache.iterdir())) == 2


def test_offsets_that_frames_share_are_kept_once_and_their_own_are_not(tmp_path, cache, monkeypatch):
    monkeypatch.setattr(index, "_LARGE", 100)
    monkeypatch.setattr(index, "_MOST_LARGE", 3)
    root = dataset("VHAP export", tmp_path / "subject")
    first = open_sequence(root)
    (path,) = cache.iterdir()
    with np.load(path) as archive:
        assert len([key for key in archive.files if key.startswith("large/")]) == 1
    assert_same(open_sequence(root), first)
    for row in range(6):
        offset = np.full((1, len(first.template.v_template), 3), 1e-3 * row, np.float32)
        change_arrays(root / "flame_param" / f"{row:05d}.npz", dynamic_offset=offset)
    own = open_sequence(root)
    with np.load(path) as archive:
        assert not [key for key in archive.files if key.startswith(("large/", "rows/"))]
    assert_same(open_sequence(root), own)
    assert torch.equal(
        own.frames[4].parameters.dynamic_offset,
        torch.full_like(own.frames[4].parameters.dynamic_offset, 4e-3),
    )


def test_arrays_come_back_as_float32_whatever_they_were(tmp_path):
    arrays = {
        "scalar": np.asarray(2.5),
        "whole": np.arange(3),
        "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "none": np.zeros((0, 3)),
    }
    for _ in range(2):
        kept = FileIndex(tmp_path)
        ours = kept.arrays(tmp_path, lambda path: arrays)
        kept.save()
        for key, array in arrays.items():
            assert ours[key].dtype == np.float32
            assert ours[key].shape == array.shape
            np.testing.assert_array_equal(ours[key], array)
        words = kept.arrays(tmp_path.parent, lambda path: {"words": np.array(["a"])})
        assert words["words"].tolist() == ["a"]


def test_short_sequences_are_not_kept(tmp_path, cache, monkeypatch):
    monkeypatch.setattr(index, "FEWEST_FILES", 13)  # six pictures and six masks
    open_sequence(dataset("VHAP export", tmp_path / "subject"))
    assert not cache.exists()


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x"}, "/x/samira_warp"),
        ("linux", {}, "/home/me/.cache/samira_warp"),
        ("darwin", {}, "/home/me/Library/Caches/samira_warp"),
        ("linux", {"SAMIRA_WARP_CACHE": "/mine"}, "/mine"),
    ],
)
def test_the_users_cache_folder(monkeypatch, platform, variables, expected):
    for name in ("SAMIRA_WARP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.setattr(sys, "platform", platform)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert str(cache_folder()) == expected


FRAMES, SIZE = 1000, 64


@pytest.fixture(scope="module")
def long_root(tmp_path_factory):
    """A long export: every picture, mask and parameter file is one file by many names."""
    root = tmp_path_factory.mktemp("long") / "subject"
    film = make_film(frames=2, width=SIZE, height=SIZE)
    write_layout("VHAP export", film, root)
    np.savez(root / "template.npz", **tiny_template())
    entry = json.loads((root / "transforms.json").read_text())["frames"][0]
    entries = []
    for number in range(FRAMES):
        names = {"file_path": f"images/{number:05d}.png", "fg_mask_path": f"fg_masks/{number:05d}.png"}
        names["flame_param_path"] = f"flame_param/{number:05d}.npz"
        for path in names.values():
            if number > 1:
                os.link((root / path).with_stem("00000"), root / path)
        entries.append({**entry, **names, "timestep_index": number})
    (root / "transforms.json").write_text(json.dumps({"frames": entries}))
    return root


def test_a_long_sequence_is_read_once_and_streamed(long_root, reads):
    first = open_sequence(long_root, split="0.9")
    assert len(first.frames) == FRAMES
    assert len(reads) == 2 * FRAMES
    reads.clear()
    assert_same(open_sequence(long_root, split="0.9"), first)
    assert reads == []
    frame_bytes = SIZE * SIZE * 4 * 2
    tracemalloc.start()
    with PixelCache(first.frames, resolution=SIZE, max_bytes=5 * frame_bytes) as pixels:
        for number in range(0, FRAMES, 5):
            pixels.prefetch([number, min(number + 5, FRAMES - 1)])
            assert pixels[number].image.shape == (SIZE, SIZE, 3)
        kept = pixels.kept_bytes
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # the 200 that were seen take more than the budget, which is used to the last frame
    assert 4 * frame_bytes < kept <= 5 * frame_bytes
    # what is kept, and a few on their way in floats, with what decoding takes
    assert peak < kept + 40 * frame_bytes


def test_a_copy_is_another_folder(long_root, tmp_path, reads):
    open_listing(long_root, split="0.9")
    reads.clear()
    shutil.copytree(long_root, tmp_path / "copy", copy_function=os.link)
    open_listing(tmp_path / "copy", split="0.9")
    assert len(reads) == 2 * FRAMES


@pytest.mark.parametrize("replaced", ["in place", "by another file"])
def test_a_file_of_the_same_size_and_time_is_read_again(tmp_path, replaced):
    """Archives, copies and re-tracked takes keep a file's time; the system's own time of the change moves."""
    root = dataset("VHAP export", tmp_path / "subject")
    first = open_sequence(root).frames[0]
    path = first.parameters_path
    status, rotation = path.stat(), first.parameters.rotations[0].clone()
    change_arrays(path, rotation=lambda array: array + np.float32(0.25))
    if replaced == "by another file":
        shutil.copy(path, tmp_path / "other.npz")
        (tmp_path / "other.npz").replace(path)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (status.st_size, status.st_mtime_ns)
    torch.testing.assert_close(open_sequence(root).frames[0].parameters.rotations[0], rotation + 0.25)
