"""The run folder is one training's own while it works in it."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from samira_warp.io.files import provisional_folder
from samira_warp.support.errors import UserError, reason

LOCK_FILE = ".lock"
"""Locked while a training works in the folder; the system takes the lock from a process that died."""


_WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Errors of file systems that have no locks, as some of a network have none."""


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep other trainings out of a run folder, which is made where it is not there.

    It is tried for writing by that, before anything long begins; a folder that was made and in which nothing
    was written is removed again. On a file system without locks, a line says that nobody is kept out.

    Raises:
        UserError: The folder cannot be written, or another training is at work in it.
    """
    if folder.exists() and not folder.is_dir():
        raise UserError(folder, expected="a folder", found="a file")
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(provisional_folder(folder))
            stack.enter_context(_locked(folder))
        except OSError as error:
            raise UserError(folder, expected="a folder that can be written", found=reason(error)) from error
        yield


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    lock = FileLock(folder / LOCK_FILE)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise UserError(
            folder, expected="a folder that no other training uses", found="one at work in it"
        ) from None
    except (OSError, NotImplementedError) as error:
        if isinstance(error, OSError) and error.errno not in _WITHOUT_LOCKS:
            raise
        print(f"{folder}: no locks there; take care that no other training uses it", file=sys.stderr)
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            (folder / LOCK_FILE).unlink()  # while it is held: whoever waits for it finds the name gone
        lock.release()
