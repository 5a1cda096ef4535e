"""Pickles are read without running anything: what they may hold, what they may not, and a thousand hostile
ones."""

import contextlib
import functools
import io
import os
import pickle
import random
import struct
import sys
import zipfile

import numpy as np
import pytest
import scipy.sparse
import torch

from samira_warp.io import pickles
from samira_warp.io.pickles import arrays_of, as_array, read_pickle, read_pickled_npy, read_torch_archive
from samira_warp.support.errors import UserError

CONTENT = {
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "faces": np.array([[1, 2, 3]], np.uint32),
    "big end first": np.arange(3, dtype=">f4"),
    "none": np.zeros((0, 3)),
    "number": np.float64(2.5),
    "flags": np.array([True, False]),
    "by column": scipy.sparse.csc_matrix(np.diag([1.0, 0.0, 3.0])),
    "by row": scipy.sparse.csr_matrix(np.arange(6.0).reshape(2, 3)),
    "list": [1, 2.5],
    "scalar": 4,
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "some file.pkl"


def old_names(written):
    """Names as numpy 1 and scipy 1.7 gave them."""
    for new, old in (
        (b"numpy._core.", b"numpy.core."),
        (b"scipy.sparse._csc\n", b"scipy.sparse.csc\n"),
        (b"_csr\n", b"csr\n"),
    ):
        written = written.replace(new, old)
    return written


@pytest.mark.parametrize("names", [bytes, old_names])
@pytest.mark.parametrize("protocol", range(6))
def test_arrays_come_back(path, protocol, names):
    if names is old_names and protocol >= 4:
        pytest.skip("names have their length before them")
    path.write_bytes(names(pickle.dumps(CONTENT | {"text": "lbs", "bytes": b"", "set": {1}}, protocol)))
    read = read_pickle(path)
    assert read["text"] == "lbs"
    for key, expected in CONTENT.items():
        ours = as_array(read[key])
        expected = expected.toarray() if scipy.sparse.issparse(expected) else np.asarray(expected)
        assert ours.dtype == expected.dtype
        np.testing.assert_array_equal(ours, expected)


def test_python_2_wrote_array_data_as_text(path):
    """Protocol 2 of Python 2: data as a byte string, here -1.5 and 3, and a set by its name in that
    version."""
    data = struct.pack("<2d", -1.5, 3.0)
    state = (
        b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x10"
        + data
        + b"tb"
    )
    array = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R" + state
    path.write_bytes(b"\x80\x02}(U\x01a" + array + b"U\x01bc__builtin__\nset\n]U\x01xa\x85Ru.")
    np.testing.assert_array_equal(as_array(read_pickle(path)["a"]), [-1.5, 3.0])


def test_what_is_no_array(path):
    path.write_bytes(
        pickle.dumps({"text": "a", "mixed": [1, "a"], "none": None, "objects": np.array([{}], object)}, 2)
    )
    assert [as_array(value) for value in read_pickle(path).values()] == [None] * 4


def test_a_torch_archive(tmp_path):
    torch.save({"flame": {"exp": np.ones((1, 3), np.float32)}, "frame_id": "00001"}, tmp_path / "a.frame")
    read = read_torch_archive(tmp_path / "a.frame")
    assert read["frame_id"] == "00001"
    np.testing.assert_array_equal(as_array(read["flame"]["exp"]), np.ones((1, 3)))


def test_an_object_in_an_npy(tmp_path):
    np.save(tmp_path / "a.npy", {"vt": np.ones((2, 2))})
    np.testing.assert_array_equal(as_array(read_pickled_npy(tmp_path / "a.npy")["vt"]), np.ones((2, 2)))


@pytest.fixture
def armed(tmp_path, monkeypatch):
    """Nothing that a pickle could call may be called while one is read: a list of what was, and a file that
    is there if code was run."""
    called = []
    for module in (os, sys.modules[os.name]):
        for name in ("system", "execv", "getcwd", "listdir"):
            monkeypatch.setattr(module, name, functools.partial(called.append, name))
    yield called
    assert called == []
    assert not (tmp_path / "ran").exists()


class Calls:
    """Unpickled, it would call."""

    def __init__(self, function, *arguments):
        self.by = function, arguments

    def __reduce__(self):
        return self.by


def refusal(path, content, read=read_pickle):
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        read(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert message.isprintable()
    assert len(message) < len(str(path)) + 500
    return message


HOSTILE = {
    "os.system": b"cposix\nsystem\n(S'id'\ntR.",
    "eval": b"c__builtin__\neval\n(S'1'\ntR.",
    "getattr": b"c__builtin__\ngetattr\n(c__builtin__\nset\nS'x'\ntR.",
    "a stand-in's own module": b"csamira_warp.io.pickles\n_ALLOWED\n.",
    "numpy's own loader": b"cnumpy\nload\n(S'a'\ntR.",
    "a name within a name": b"\x80\x04\x8c\x05numpy\x8c\x0fndarray.tofile\x93.",
    "a name with colours": b"c\x1b[31mos\nsystem\n(S'id'\ntR.",
    "a long name": b"c" + b"o" * 5000 + b"\nsystem\n.",
    "torch's storages": b"ctorch\nFloatStorage\n.",
    "codecs": b"c_codecs\ndecode\n(S'a'\nS'hex'\ntR.",
    "an old object": b"(S'id'\nios\nsystem\n.",
    "a built object": b"(cposix\nsystem\nS'id'\no.",
    "a nested call": b"cnumpy\ndtype\n(cposix\nsystem\n(S'id'\ntRtR.",
    "an extension": b"\x82\x01.",
    "a persistent name": b"Pabc\n.",
    "a memo of gigabytes": b"\x80\x02Nr\xff\xff\xff\x7f.",
    "a memo of text": b"Np4000000000\n.",
    "a string of exabytes": b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7fabc.",
    "a frame of exabytes": b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7fN.",
    "a long list of nothing": b"\x80\x02" + b"(" * 30_000 + b".",
    "deep tuples": b"\x80\x02N" + b"\x85" * 30_000 + b".",
    "deep tuples as a key": b"\x80\x02}N" + b"\x85" * 4_900 + b"Ns.",
    "deep lists": b"\x80\x02]" + b"]\x85" * 30_000 + b".",
    "a huge number": b"L" + b"9" * 100_000 + b"L\n.",
    "nothing": b"",
    "no end": pickle.dumps([1, 2, 3], 2)[:-1],
    "text": b"hello",
    "nothing on the stack": b".",
    "an array of exabytes": b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n"
    b"cnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01\x8a\x08\xff\xff\xff\xff\xff\xff\xff\x7f\x85"
    b"cnumpy\ndtype\nU\x02f8\x85R\x89U\x04abcdtb.",
    "a dtype with fields": b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n"
    b"cnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01K\x01\x85"
    b"cnumpy\ndtype\nU\x05f8,f8\x85R\x89U\x10" + bytes(16) + b"tb.",
    "a changed class": b"\x80\x02cnumpy\nndarray\nN}U\x0c__setstate__U\x01xs\x86b.",
    "a class called with itself": b"\x80\x02ccopy_reg\n_reconstructor\nccopy_reg\n_reconstructor\n\x85R.",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_pickles_are_refused(path, armed, name):
    content = HOSTILE[name]
    if name == "deep tuples as a key":  # within the bounds, and no harm
        path.write_bytes(content)
        read_pickle(path)
    else:
        refusal(path, content)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("os.system", "posix.system"),
        ("eval", "__builtin__.eval"),
        ("a nested call", "posix.system"),
        ("a name with colours", r"\x1b[31mos.system"),
    ],
)
def test_what_a_pickle_names_is_said(path, name, said):
    assert f"the name {said}, which is not loaded" in refusal(path, HOSTILE[name])


def test_a_stand_in_cannot_be_changed(path):
    refusal(path, HOSTILE["a changed class"])
    path.write_bytes(pickle.dumps({"a": np.arange(3.0)}, 2))
    np.testing.assert_array_equal(as_array(read_pickle(path)["a"]), np.arange(3.0))


@pytest.mark.parametrize("kind", ["data.pkl", "two", "compressed bomb", "text", "cut"])
def test_hostile_archives_are_refused(tmp_path, armed, kind, monkeypatch):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        if kind == "compressed bomb":
            monkeypatch.setattr(pickles, "MOST_BYTES", 1 << 20)
            archive.writestr("a/data.pkl", bytes(2 << 20))
        else:
            archive.writestr("a/data.pkl", HOSTILE["os.system"])
        if kind == "two":
            archive.writestr("b/data.pkl", pickle.dumps(1))
    content = {"text": b"hello", "cut": file.getvalue()[:-30]}.get(kind, file.getvalue())
    refusal(tmp_path / "a.frame", content, read_torch_archive)


@pytest.mark.parametrize("kind", ["numbers", "objects", "pickle", "header", "text"])
def test_hostile_npy_files_are_refused(tmp_path, armed, kind):
    file = io.BytesIO()
    if kind == "header":
        file.write(b"\x93NUMPY\x01\x00\x20\x00{'descr': __import__('os').getcwd()}")
    elif kind == "text":
        file.write(b"hello")
    elif kind == "pickle":
        np.save(file, np.array(Calls(os.getcwd), object), allow_pickle=True)
    else:
        np.save(file, np.arange(3) if kind == "numbers" else np.array([{}, {}], object), allow_pickle=True)
    refusal(tmp_path / "a.npy", file.getvalue(), read_pickled_npy)


def mutated(rng, content):
    """The content with some bytes changed, cut, doubled or moved, or an operation put in."""
    content = bytearray(content)
    for _ in range(rng.randint(1, 6)):
        at, length = rng.randrange(len(content)), rng.randint(1, 12)
        kind = rng.randrange(6)
        if kind == 0:
            content[at] = rng.randrange(256)
        elif kind == 1:
            del content[at : at + length]
        elif kind == 2:
            content[at:at] = content[at : at + length]
        elif kind == 3:
            content[at:at] = rng.choice(
                [
                    b"R",
                    b"b",
                    b"o",
                    b"\x81",
                    b"\x93",
                    b"0",
                    b"(",
                    b"t",
                    b"\x85",
                    b"2",
                    b"}",
                    b"h\x01",
                    b"j\xff\xff\xff\x7f",
                ]
            )
        elif kind == 4:
            content[at:at] = rng.choice(list(HOSTILE.values()))[:60].rstrip(b".")
        else:
            content[at : at + 4] = rng.randbytes(4)
        content = content or bytearray(b".")
    return bytes(content)


def calling(rng, marker):
    """A pickle that calls something of this machine, somewhere within plain data."""
    code = f"open({str(marker)!r}, 'w')"
    value = rng.choice(
        [
            Calls(eval, code),
            Calls(exec, code),
            Calls(open, str(marker), "w"),
            Calls(os.system, f"touch '{marker}'"),
        ]
    )
    if rng.random() < 0.5:
        function = rng.choice(
            [os.getcwd, os.listdir, sys.exit, print, getattr, __import__, np.load, np.fromfile, torch.load]
        )
        value = Calls(function, *rng.sample(["id", "/etc/passwd", 0, 1.5, b"x", value], rng.randint(0, 3)))
    for _ in range(rng.randint(0, 5)):
        value = rng.choice(
            [[value], (value, 1), {"a": value}, {"flame": [np.zeros(2), value]}, Calls(np.dtype, value)]
        )
    return pickle.dumps(value, rng.randint(0, 5))


@pytest.fixture
def thousand(tmp_path):
    """Pickles, and whether each is known to call something: written before the functions that they name are
    watched."""
    rng = random.Random(0)
    small = {
        "v": np.arange(6.0).reshape(2, 3),
        "s": scipy.sparse.csc_matrix(np.eye(2)),
        "t": "lbs",
        "n": [1, 2.0, None, True],
    }
    sources = [pickle.dumps(small, protocol) for protocol in range(6)]
    calls = [(calling(rng, tmp_path / "ran"), True) for _ in range(300)]
    return calls + [(mutated(rng, rng.choice(sources)), False) for _ in range(800)]


def test_a_thousand_hostile_pickles(tmp_path, thousand, armed):
    """Each is read to the end or refused in one line; nothing else is called or raised."""
    path, refused = tmp_path / "flame.pkl", []
    for content, calls in thousand:
        path.write_bytes(content)
        try:
            value = read_pickle(path)
        except UserError as fault:
            refused.append(str(fault))
            continue
        assert not calls
        for part in value.values() if isinstance(value, dict) else [value]:
            with contextlib.suppress(ValueError, TypeError, IndexError):
                as_array(part)
    assert len(refused) > 800
    assert all(str(path) in message and message.isprintable() for message in refused)


def test_mutated_archives(tmp_path, armed):
    """Each is read or refused; nothing else is raised."""
    rng, path = random.Random(1), tmp_path / "a.frame"
    torch.save({"flame": {"exp": np.ones((1, 3), np.float32)}, "frame_id": "00001"}, path)
    whole = path.read_bytes()
    for _ in range(300):
        path.write_bytes(mutated(rng, whole))
        with contextlib.suppress(UserError):
            value = read_torch_archive(path)
            arrays_of(
                path, value["flame"] if isinstance(value, dict) and "flame" in value else value, ("exp",)
            )


def test_keys_that_are_missing_are_said_whatever_the_others_are(path):
    path.write_bytes(HOSTILE["deep tuples as a key"])
    with pytest.raises(UserError, match="expected the key shapedirs, found none"):
        arrays_of(path, read_pickle(path), ("shapedirs",))
    with pytest.raises(UserError, match="expected a dictionary of arrays"):
        arrays_of(path, [1], ("shapedirs",))


@pytest.mark.parametrize(
    "change",
    [
        {"indices": np.array([0, 5])},
        {"indices": np.array([0, -1])},
        {"indices": np.array([0.0, 1.0])},
        {"indptr": np.array([0, 2, 1])},
        {"indptr": np.array([0, 1])},
        {"indptr": np.array([0, 9, 9])},
        {"data": np.ones(3)},
        {"data": None},
        {"_shape": (2, 1 << 40)},
        {"_shape": (-2, 2)},
        {"_shape": (2, 3, 4)},
        {"_shape": None},
    ],
    ids=str,
)
def test_sparse_matrices_that_do_not_hold_together(path, change):
    """scipy itself crashes on some of these."""
    matrix = scipy.sparse.csc_matrix(np.eye(2))
    vars(matrix).update(change)
    path.write_bytes(pickle.dumps(matrix, 2))
    with pytest.raises(ValueError, match="sparse matrix"):
        as_array(read_pickle(path))
