"""The run folder is one training's own while it works in it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from samira_warp.io.files import provisional_folder
from samira_warp.support.errors import UserError, reason

LOCK_FILE = ".lock"
"""Locked while a training works in the folder, by the system, which takes the lock from a process that died."""


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep other trainings out of a run folder, which is made where it is not there.

    It is tried for writing by that, before anything long begins; a folder that was made and in which nothing
    was written is removed again.

    Raises:
        UserError: The folder cannot be written, or another training is at work in it.
    """
    if folder.exists() and not folder.is_dir():
        raise UserError(folder, expected="a folder", found="a file")
    with contextlib.ExitStack() as stack:
        lock = FileLock(folder / LOCK_FILE)
        try:
            stack.enter_context(provisional_folder(folder))
            lock.acquire(timeout=0)
        except Timeout:
            raise UserError(
                folder, expected="a folder that no other training uses", found="one at work in it"
            ) from None
        except (OSError, NotImplementedError) as error:
            found = reason(error) if isinstance(error, OSError) else error
            raise UserError(
                folder, expected="a folder that can be written and locked", found=found
            ) from error
        stack.callback(_let_go, lock)
        yield


def _let_go(lock: FileLock) -> None:
    with contextlib.suppress(OSError):
        Path(lock.lock_file).unlink()  # while it is held: whoever waits for it finds the name gone
    lock.release()
