"""Pickles of arrays (FLAME's files, metrical-tracker's frames) read without running anything that they name.

A pickle is a program: it may name any function of the machine and call it. Here every name is looked up in a
short list, and what stands under it are classes of this module that only keep what they are given. Any other
name is refused.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from samira_warp.support.errors import UserError

MOST_OPERATIONS = 5_000
"""Of one pickle, besides plain numbers. FLAME's files take some hundreds; the limit bounds how deep a hostile
one can nest and how much it can multiply."""

MOST_NUMBERS = 1 << 20
"""Of one pickle, written one by one: masks saved as lists have thousands. Numbers nest nothing."""

MOST_BYTES = 1 << 28
"""Of one file, and of one sparse matrix made dense; FLAME with all of its shapes in float64 takes a fifth of
it."""

_MOST_NESTED = 4
"""How many stand-ins may lie in one another on the way to an array: chumpy keeps an array in itself, perhaps
in a copy of itself."""

_FORBIDDEN = {"EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID", "NEXT_BUFFER", "READONLY_BUFFER"}
_PUTS = {"PUT", "BINPUT", "LONG_BINPUT"}
_NUMBERS = {"BININT", "BININT1", "BININT2", "INT", "LONG1", "BINFLOAT", "FLOAT", "NEWTRUE", "NEWFALSE"}
_EXPECTED = "a pickle of arrays alone (of numpy, scipy.sparse or chumpy)"


def read_pickle(path: Path) -> Any:
    """Read a pickle of plain values and arrays, of Python 2 or 3.

    Returns:
        Dictionaries, lists, tuples, numbers and text as they are; what stands for an array is for `as_array`.

    Raises:
        UserError: The file is missing, broken, larger than any of its kind, or names anything but arrays.
    """
    return _unpickle(_content(path), path)


def read_torch_archive(path: Path) -> Any:
    """Read what ``torch.save`` made of a dictionary of numpy arrays.

    Metrical-tracker's ``.frame`` files are such.

    Raises:
        UserError: As in read_pickle.
    """
    content = _content(path)
    if not content.startswith(b"PK"):
        raise UserError(
            path, expected="an archive of torch.save (torch 1.6 or later)", found="another file's first bytes"
        )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [info for info in archive.infolist() if info.filename.endswith("/data.pkl")]
            if len(members) != 1 or members[0].file_size > MOST_BYTES:
                raise ValueError(f"{len(members)} files data.pkl, or one too large")
            content = archive.read(members[0])
    except Exception as fault:  # a broken archive breaks in any way that its compression can
        raise UserError(path, expected="an archive of torch.save", found=_brief(fault)) from fault
    return _unpickle(content, path)


def read_pickled_npy(path: Path) -> Any:
    """Read the one value of a ``.npy`` file that holds objects, as FLAME's texture_data_*.npy.

    Raises:
        UserError: As in read_pickle.
    """
    file = io.BytesIO(_content(path))
    try:
        version = np.lib.format.read_magic(file)
        read_header = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read_header(file)
    except Exception as fault:  # numpy parses the header as Python's text, which breaks in many ways
        raise UserError(path, expected="an .npy file", found=_brief(fault)) from fault
    if shape != () or not dtype.hasobject:
        raise UserError(path, expected="an .npy file of one object", found=f"{dtype} of shape {shape}")
    value = _unpickle(file.read(), path)
    items = value.items if isinstance(value, _StoredArray) else None
    if not items:
        raise UserError(path, expected="an .npy file of one object", found="none")
    return items[0]


def as_array(value: object) -> np.ndarray | None:
    """The array that a value of `read_pickle` stands for.

    A sparse matrix is made dense, a list of numbers an array; None for all else.

    Raises:
        ValueError: A sparse matrix does not hold together.
    """
    for _ in range(_MOST_NESTED):
        if isinstance(value, _Chumpy):
            value = value.x
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, _StoredArray):
        return value.values
    if isinstance(value, _Sparse):
        return value.dense()
    if isinstance(value, int | float) or (
        isinstance(value, list | tuple) and all(isinstance(entry, int | float) for entry in value)
    ):
        return np.asarray(value)
    return None


def arrays_of(path: Path, values: object, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Arrays by name out of what a pickle or an archive held.

    Raises:
        UserError: It held no dictionary, or a key is missing or is no array.
    """
    if not isinstance(values, dict):
        raise UserError(path, expected="a dictionary of arrays", found="something else")
    arrays = {}
    for key in keys:
        if key not in values:
            names = ", ".join(sorted(name for name in values if isinstance(name, str)))
            raise UserError(
                path, expected=f"the key {key}", found=f"only {_printable(names)}" if names else "none"
            )
        try:
            array = as_array(values[key])
        except (ValueError, TypeError, IndexError) as fault:
            raise UserError(f"{path}: {key}", expected="an array", found=_brief(fault)) from fault
        if array is None:
            raise UserError(f"{path}: {key}", expected="an array", found="something else")
        arrays[key] = array
    return arrays


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise UserError(path, expected="a file", found="a folder" if path.is_dir() else "no such file")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise UserError(path, expected=f"at most {MOST_BYTES >> 20} MiB", found=f"{size >> 20} MiB")
    return path.read_bytes()


def _unpickle(content: bytes, path: Path) -> Any:
    try:
        _survey(content)
        return _Unpickler(io.BytesIO(content), path).load()
    except UserError:
        raise
    except Exception as fault:  # a broken pickle breaks in any way that its operations can
        raise UserError(path, expected=_EXPECTED, found=_brief(fault)) from fault


def _survey(content: bytes) -> None:
    """Look through a pickle's operations before any is done.

    A memo index allocates memory up to itself, and a deep nest of tuples overflows the stack when it is
    hashed: both are bounded here.
    """
    numbers = operations = 0
    for operation, argument, _ in pickletools.genops(content):
        if operation.name in _NUMBERS:
            numbers += 1
        else:
            operations += 1
        if operations > MOST_OPERATIONS:
            raise ValueError(f"more than {MOST_OPERATIONS} operations")
        if numbers > MOST_NUMBERS:
            raise ValueError(f"more than {MOST_NUMBERS} numbers")
        if operation.name in _FORBIDDEN:
            raise ValueError(f"the operation {operation.name}")
        if operation.name in _PUTS and int(argument or 0) > MOST_OPERATIONS:
            raise ValueError(f"a memo of {argument} entries")


def _brief(fault: BaseException) -> str:
    """What went wrong, printable and short whatever the file holds."""
    return f"{type(fault).__name__}: {_printable(str(fault))}"


def _printable(text: str) -> str:
    return ascii(text)[1:-1][:160]


class _Sealed(type):
    """Classes that no pickle can change: its BUILD operation sets attributes of whatever it is given."""

    def __setattr__(cls, name: str, value: object) -> None:
        raise TypeError(f"{cls.__name__} is not to be changed")


class _Inert(metaclass=_Sealed):
    """What any harmless name may stand for: keeps nothing."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        return super().__new__(cls)

    def __init__(self, *arguments: object) -> None:
        pass

    def __setstate__(self, state: object) -> None:
        pass


class _Dtype(_Inert):
    """numpy.dtype: a kind and a byte order."""

    code: object = ""
    order: object = "|"

    def __init__(self, *arguments: object) -> None:
        if arguments:
            self.code = arguments[0]

    def __setstate__(self, state: Any) -> None:
        self.order = state[1]

    @property
    def numpy(self) -> np.dtype:
        if (
            not isinstance(self.code, str)
            or not re.fullmatch("[fiub][1248]", self.code)
            or self.order not in ("<", ">", "|", "=")
        ):
            raise ValueError("an array of something else than numbers")
        return np.dtype(self.order + self.code)


class _StoredArray(_Inert):
    """numpy.ndarray: ``values``, or the ``items`` of an array of objects."""

    values: np.ndarray | None = None
    items: list[object] | None = None

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, fortran, data = state
        if not isinstance(dtype, _Dtype):
            raise ValueError("an array without a dtype")
        if isinstance(data, list):
            self.items = data
        else:
            self.values = _array(data, dtype, shape, "F" if fortran is True else "C")


def _array(data: object, dtype: _Dtype, shape: object, order: object) -> np.ndarray:
    raw = data.encode("latin1") if isinstance(data, str) else data
    if not isinstance(raw, bytes | bytearray) or not isinstance(shape, tuple) or order not in ("C", "F"):
        raise ValueError("an array that does not hold together")
    if not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError("an array without a shape")
    return np.frombuffer(raw, dtype.numpy).reshape(shape, order=order)


class _Reconstruct(_Inert):
    """numpy's function that makes an array before its state is known."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        return _StoredArray()


class _FromBuffer(_Inert):
    """numpy's function of pickle protocol 5: (buffer, dtype, shape, order)."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        stored = _StoredArray()
        data, dtype, shape, order = arguments
        stored.values = _array(data, dtype, shape, order)  # type: ignore[arg-type]
        return stored


class _Scalar(_Inert):
    """numpy's function of a single number: (dtype, bytes)."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        dtype, data = arguments
        return _FromBuffer(data, dtype, (), "C")


class _Sparse(_Inert):
    """scipy.sparse's matrices compressed by column.

    Made dense here: scipy's own code trusts what it is given, and crashes.
    """

    by_rows = False
    state: object = None

    def __setstate__(self, state: object) -> None:
        self.state = state

    def dense(self) -> np.ndarray:
        if not isinstance(self.state, dict):
            raise ValueError("a sparse matrix without content")
        shape = self.state.get("_shape", self.state.get("shape"))
        data, indices, pointers = (as_array(self.state.get(name)) for name in ("data", "indices", "indptr"))
        if (
            not isinstance(shape, tuple)
            or len(shape) != 2
            or not all(type(size) is int and size >= 0 for size in shape)
        ):
            raise ValueError("a sparse matrix without a shape")
        if shape[0] * shape[1] * 8 > MOST_BYTES or data is None or indices is None or pointers is None:
            raise ValueError("a sparse matrix that does not hold together")
        lines, across = shape if self.by_rows else shape[::-1]
        ends = np.concatenate([[0], pointers[1:], [len(data)]])
        holds = (
            data.ndim == indices.ndim == pointers.ndim == 1
            and indices.dtype.kind in "iu"
            and pointers.dtype.kind in "iu"
        )
        if (
            not holds
            or len(pointers) != lines + 1
            or len(indices) != len(data)
            or (ends[1:] < ends[:-1]).any()
            or ends[-2] != len(data)
        ):
            raise ValueError("a sparse matrix that does not hold together")
        if len(indices) and not 0 <= indices.min() <= indices.max() < across:
            raise ValueError("a sparse matrix with indices beyond its shape")
        dense = np.zeros((lines, across), data.dtype)
        np.add.at(dense, (np.repeat(np.arange(lines), np.diff(ends[:-1])), indices), data)
        return dense if self.by_rows else dense.T


class _SparseRows(_Sparse):
    """scipy.sparse's matrices compressed by row."""

    by_rows = True


class _Chumpy(_Inert):
    """chumpy's array: it keeps numpy's as ``x``."""

    x: object = None

    def __setstate__(self, state: object) -> None:
        self.x = state.get("x")  # type: ignore[attr-defined]


class _Encode(_Inert):
    """The codec by which protocol 2 of Python 3 writes bytes: (text, "latin1")."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        text, codec = arguments
        if not isinstance(text, str) or codec not in ("latin1", "latin-1"):
            raise ValueError("bytes in another codec than latin1")
        return text.encode("latin1")


class _NewObject(_Inert):
    """The function by which protocols 0 and 1 make objects: (class, base, state)."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        kind = arguments[0]
        if not isinstance(kind, _Sealed):
            raise ValueError("an object of no class")
        return kind()


class _Bytes(_Inert):
    """Empty bytes in protocol 2."""

    def __new__(cls, *arguments: object, **_: object) -> Any:
        return b""


_SPARSE = {"csc_matrix": _Sparse, "csc_array": _Sparse, "csr_matrix": _SparseRows, "csr_array": _SparseRows}
_ALLOWED: dict[tuple[str, str], type] = {
    ("_codecs", "encode"): _Encode,
    ("chumpy.ch", "Ch"): _Chumpy,
    ("chumpy", "Ch"): _Chumpy,
    **{("numpy", name): stand_in for name, stand_in in (("ndarray", _StoredArray), ("dtype", _Dtype))},
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _Reconstruct for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _Scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _FromBuffer for core in ("core", "_core")},
    **{
        (f"scipy.sparse{part}", name): kind
        for name, kind in _SPARSE.items()
        for part in ("", f".{name[:3]}", f"._{name[:3]}")
    },
    **{(module, "_reconstructor"): _NewObject for module in ("copy_reg", "copyreg")},
    **{
        (module, name): _Inert
        for module in ("__builtin__", "builtins")
        for name in ("object", "set", "frozenset")
    },
    **{(module, "bytes"): _Bytes for module in ("__builtin__", "builtins")},
}
"""Every name that a pickle may use, and what stands for it."""


class _Unpickler(pickle.Unpickler):
    """Looks names up in `_ALLOWED` alone."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        super().__init__(file, encoding="latin1")  # Python 2's text and array data alike
        self.path = path

    def find_class(self, module: str, name: str) -> type:
        stand_in = _ALLOWED.get((module, name))
        if stand_in is None:
            raise UserError(
                self.path,
                expected=_EXPECTED,
                found=f"the name {_printable(f'{module}.{name}')}, which is not loaded",
            )
        return stand_in
