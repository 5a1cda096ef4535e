"""Writing files and folders so that what was there stays whole until what replaces it is."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from samira_warp.support.errors import UserError, reason

if TYPE_CHECKING:
    from torch import Tensor


def cache_folder() -> Path:
    """Where this project keeps what it can make or fetch again.

    It is ``SAMIRA_WARP_CACHE``, else its own folder among the user's caches. Nothing is made on disk.

    Raises:
        UserError: Neither the environment nor the system knows of a folder for it.
    """
    chosen = os.environ.get("SAMIRA_WARP_CACHE")
    if chosen:
        return Path(chosen)
    try:
        return _users_caches() / "samira_warp"
    except RuntimeError as error:  # of Path.home()
        expected = "a folder to keep what can be made or fetched again"
        raise UserError("SAMIRA_WARP_CACHE", expected=expected, found="no home folder") from error


def _users_caches() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@contextlib.contextmanager
def provisional_folder(folder: Path) -> Iterator[None]:
    """Make a folder, and those that it is in; what was made and is empty at the end is removed again.

    Raises:
        OSError: It cannot be made.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with contextlib.suppress(OSError):  # one with something in it ends the row
            for path in missing:
                path.rmdir()


def check_writable(folder: Path) -> None:
    """Raise UserError unless files can be written into a folder, which need not be there yet.

    For what takes long before it writes. Nothing is left behind.
    """
    probe = folder / f".samira_warp.{os.getpid()}"
    try:
        with provisional_folder(folder):
            try:
                probe.write_bytes(b"\0")
            finally:
                probe.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(folder, expected="a folder that can be written", found=reason(error)) from error


def replace_folder(target: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` fill a new folder and put it in the place of ``target``.

    The new folder is written beside the target under a hidden name, flushed to the disk and renamed. Whatever
    happens before the rename (a full disk, an interrupt) leaves the target as it was, and removes what was
    written. What a killed process left is removed as well.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = target.parent / f".{target.name}.new"
    try:
        _settle(target)
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        write(fresh)
        _put_in_place(fresh, target)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def resume_folder(target: Path, fill: Callable[[Path], None], *, recipe: str) -> None:
    """As `replace_folder`, for what takes long: what was written stays, and the next call goes on with it.

    It lies beside the target under a hidden name until it is whole, whatever ends this process. Of several
    processes, one at a time may do this.

    Args:
        target: The folder to make.
        fill: Fills the folder that it is given, in which it finds what an earlier call wrote for the same
            recipe; files are whole that were written by `whole_file`.
        recipe: What is made, in a few letters and digits, such as a hash. What was written for another one is
            removed.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    half = target.parent / f".{target.name}.half-{recipe}"
    for other in target.parent.glob(f".{glob.escape(target.name)}.half-*"):
        if other != half:
            shutil.rmtree(other, ignore_errors=True)
    half.mkdir(exist_ok=True)
    fill(half)
    _put_in_place(half, target)


@contextlib.contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """Give a name to write a file under, which is ``target``'s once the block has ended without an error.

    The name is hidden, in the same folder and with the same suffix, and the file is flushed before it is
    renamed: under its own name it is whole, or as it was.
    """
    fresh = target.with_name(f".{target.stem}.new{target.suffix}")
    try:
        yield fresh
        _flush(fresh)
        fresh.replace(target)
    finally:
        fresh.unlink(missing_ok=True)


def replace_file(target: Path, content: str | bytes) -> None:
    """Write a file under a hidden name, text in UTF-8, flush it and rename it to ``target``.

    Who may read it follows from the process's umask, as with any new file.
    """
    with whole_file(target) as fresh:
        fresh.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def save_tensors(tensors: dict[str, Tensor], path: Path, *, metadata: dict[str, str] | None = None) -> None:
    """Write tensors by name as a safetensors file, whole or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    from safetensors.torch import save  # with torch, seconds that no other function here needs

    # safetensors' own writer leaves files that nobody but their owner can read.
    content = save({name: value.detach().contiguous() for name, value in tensors.items()}, metadata=metadata)
    try:
        replace_file(path, content)
    except OSError as error:
        raise OSError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object, in UTF-8 or UTF-16, with a byte order mark or without, as editors write it.

    Raises:
        UserError: The file is missing or holds something else.
    """
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise UserError(path, expected="a JSON file", found="no such file") from error
    except (OSError, ValueError) as error:
        raise UserError(path, expected="a JSON file", found=error) from error
    if not isinstance(content, dict):
        raise UserError(path, expected="a JSON object", found=type(content).__name__)
    return content


def _put_in_place(fresh: Path, target: Path) -> None:
    """Flush a folder and rename it to ``target``; what has that name is removed once the new one has it."""
    _settle(target)
    for path in sorted(fresh.rglob("*")):
        if path.is_file():
            _flush(path)
    _flush(fresh)
    try:
        if target.exists():
            target.rename(_moved_aside(target))
        fresh.rename(target)
        _flush(target.parent)
    finally:
        _settle(target)


def _settle(target: Path) -> None:
    """Put a folder that was moved aside back, or away where another has its place."""
    aside = _moved_aside(target)
    if aside.exists() and not target.exists():
        aside.rename(target)
    shutil.rmtree(aside, ignore_errors=True)


def _moved_aside(target: Path) -> Path:
    return target.parent / f".{target.name}.old"


def _flush(path: Path) -> None:
    """Have the disk hold a file, or the names in a folder.

    Windows opens no folders, and flushes only what is open for writing.
    """
    on_windows = sys.platform == "win32"
    if on_windows and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if on_windows else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
