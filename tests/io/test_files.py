import os
import pwd
import sys
from pathlib import Path

import pytest
import torch
from data.damage import file_size_limit
from safetensors.torch import load_file

from samira_warp import UserError
from samira_warp.io.files import (
    cache_folder,
    check_writable,
    provisional_folder,
    read_json,
    replace_file,
    replace_folder,
    resume_folder,
    save_tensors,
    whole_file,
)


def write_one(text):
    return lambda folder: (folder / "one").write_text(text)


def fail_after_writing(error):
    def write(folder):
        (folder / "one").write_text("half")
        raise error

    return write


def test_a_new_folder_takes_the_place_of_the_old(tmp_path):
    target = tmp_path / "deep" / "folder"
    replace_folder(target, write_one("first"))
    (target / "other").write_text("goes with the old one")
    replace_folder(target, write_one("second"))
    assert {path.name: path.read_text() for path in target.iterdir()} == {"one": "second"}
    assert [path.name for path in target.parent.iterdir()] == ["folder"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_leaves_the_old_one_and_nothing_else(tmp_path, error):
    target = tmp_path / "folder"
    replace_folder(target, write_one("first"))
    with pytest.raises(type(error)):
        replace_folder(target, fail_after_writing(error))
    assert (target / "one").read_text() == "first"
    with pytest.raises(type(error)):
        replace_folder(tmp_path / "another", fail_after_writing(error))
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_what_a_killed_process_left_is_cleared_away(tmp_path):
    target = tmp_path / "folder"
    for name in (".folder.new", ".folder.old"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "one").write_text(name)
    # killed between the two renames: the old one is what there was
    with pytest.raises(OSError, match="full"):
        replace_folder(target, fail_after_writing(OSError("full")))
    assert (target / "one").read_text() == ".folder.old"
    replace_folder(target, write_one("fresh"))
    assert (target / "one").read_text() == "fresh"
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_folder_that_takes_long_goes_on_with_what_it_has(tmp_path):
    target = tmp_path / "folder"
    found = []

    def fill(folder):
        found.append({path.name: path.read_text() for path in folder.iterdir()})
        (folder / str(len(found))).write_text("kept")
        if len(found) < 3:
            raise KeyboardInterrupt

    target.mkdir()
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            resume_folder(target, fill, recipe="a")
        assert list(target.iterdir()) == []
    resume_folder(target, fill, recipe="a")
    assert found == [{}, {"1": "kept"}, {"1": "kept", "2": "kept"}]
    assert sorted(path.name for path in target.iterdir()) == ["1", "2", "3"]
    assert list(tmp_path.iterdir()) == [target]


def test_what_was_begun_of_another_recipe_is_removed_and_nobody_elses(tmp_path):
    for name in ("f[o]", "foo"):  # the first one's name, as a pattern, means the second one's
        with pytest.raises(OSError, match="full"):
            resume_folder(tmp_path / name, fail_after_writing(OSError("full")), recipe="a")
    resume_folder(tmp_path / "f[o]", lambda folder: None, recipe="b")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".foo.half-a", "f[o]"]
    assert list((tmp_path / "f[o]").iterdir()) == []


def test_a_file_has_its_name_once_it_is_whole(tmp_path):
    target = tmp_path / "a.png"
    target.write_text("before")

    def fail():
        with whole_file(target) as path:
            path.write_text("half")
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fail()
    assert target.read_text() == "before"
    with whole_file(target) as path:
        assert (path.parent, path.suffix) == (target.parent, target.suffix)
        path.write_text("after")
        assert target.read_text() == "before"
    assert target.read_text() == "after"
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_in_which_nothing_was_put_goes_again_with_those_made_for_it(tmp_path):
    (tmp_path / "there").mkdir()
    with provisional_folder(tmp_path / "there" / "new" / "newer"):
        assert (tmp_path / "there" / "new" / "newer").is_dir()
    assert list((tmp_path / "there").iterdir()) == []
    with provisional_folder(tmp_path / "there" / "new" / "newer"):
        (tmp_path / "there" / "new" / "one").write_text("mine")
    assert [path.name for path in (tmp_path / "there" / "new").iterdir()] == ["one"]
    with provisional_folder(tmp_path / "there"):
        pass
    assert (tmp_path / "there").is_dir()


def test_a_folder_is_tried_for_writing_without_a_trace(tmp_path):
    check_writable(tmp_path / "new" / "newer")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("mine")
    for path, found in {
        tmp_path / "file": "something of this name is there",
        tmp_path / "file" / "new": "a file on the way to it",
    }.items():
        with pytest.raises(
            UserError, match=f"{path}: expected a folder that can be written, found .*{found}"
        ):
            check_writable(path)
    with file_size_limit(0), pytest.raises(UserError, match="larger than is allowed"):
        check_writable(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0 and not os.path.exists("/proc/1"), reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_is_named():
    with pytest.raises(UserError, match="/proc/samira: expected a folder that can be written"):
        check_writable(Path("/proc/samira"))


def test_a_file_is_replaced_whole(tmp_path):
    replace_file(tmp_path / "a.json", "{}")
    replace_file(tmp_path / "a.json", '{"b": 1}')
    assert read_json(tmp_path / "a.json") == {"b": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(
    ("text", "found"), [(None, "no such file"), ("{", "Expecting"), ("[1]", "list"), ("\udcff", None)]
)
def test_what_is_no_json_object_is_named(tmp_path, text, found):
    path = tmp_path / "a.json"
    if text is not None:
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UserError, match=r"a\.json") as caught:
        read_json(path)
    assert found is None or found in str(caught.value)


def test_tensors_come_back_and_a_file_that_cannot_be_written_is_named(tmp_path):
    values = {"a": torch.rand(3, 4).T.requires_grad_(), "b": torch.arange(3)}
    save_tensors(values, tmp_path / "t.safetensors", metadata={"name": "x"})
    found = load_file(tmp_path / "t.safetensors")
    assert all(torch.equal(found[name], value) for name, value in values.items())
    with pytest.raises(OSError, match=r"nowhere.*t\.safetensors"):
        save_tensors(values, tmp_path / "nowhere" / "t.safetensors")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such modes")
@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o002, 0o664), (0o077, 0o600)])
def test_who_may_read_a_file_follows_from_the_umask(tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        save_tensors({"a": torch.ones(3)}, tmp_path / "t.safetensors")
        replace_file(tmp_path / "a.json", "{}")
        replace_folder(tmp_path / "folder", write_one("first"))
    finally:
        os.umask(before)
    for path in (tmp_path / "t.safetensors", tmp_path / "a.json", tmp_path / "folder" / "one"):
        assert path.stat().st_mode & 0o777 == mode
    assert (tmp_path / "folder").stat().st_mode & 0o777 == mode | (mode & 0o444) >> 2


def test_tensors_are_replaced_whole(tmp_path, monkeypatch):
    path = tmp_path / "t.safetensors"
    save_tensors({"a": torch.ones(3)}, path)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"t\.safetensors: cannot be written: No space left on device"):
        save_tensors({"a": torch.zeros(3)}, path)
    monkeypatch.undo()
    assert load_file(path)["a"].sum() == 3
    assert [path.name for path in tmp_path.iterdir()] == ["t.safetensors"]


def test_a_user_without_a_home_is_told_how_to_name_a_folder(monkeypatch):
    for name in ("SAMIRA_WARP_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)

    def unknown(user):
        raise KeyError(user)

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    with pytest.raises(UserError, match=r"SAMIRA_WARP_CACHE: expected a folder .* found no home folder"):
        cache_folder()


def test_folders_are_replaced_on_windows(tmp_path, monkeypatch):
    """Windows opens no folder, and flushes no file that is open for reading alone."""
    flushed, kept = [], {}
    open_here = os.open

    def open_there(path, flags, *rest):
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied", str(path))
        descriptor = open_here(path, flags, *rest)
        kept[descriptor] = os.fspath(path), flags
        return descriptor

    def flush_there(descriptor):
        path, flags = kept[descriptor]
        assert flags & os.O_RDWR
        flushed.append(os.path.basename(path))

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(os, "open", open_there)
    monkeypatch.setattr(os, "fsync", flush_there)
    replace_folder(tmp_path / "folder", write_one("first"))
    replace_file(tmp_path / "a.json", "{}")
    monkeypatch.undo()
    assert flushed == ["one", ".a.new.json"]
    assert (tmp_path / "folder" / "one").read_text() == "first"
    assert read_json(tmp_path / "a.json") == {}
