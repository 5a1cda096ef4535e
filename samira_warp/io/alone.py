"""One process at a time makes a folder."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout


@contextlib.contextmanager
def alone(folder: Path, *, what: str) -> Iterator[None]:
    """Keep other processes from making the same folder meanwhile.

    Where one is at it, say so and wait for its end: it may have made the folder by then.

    Args:
        folder: What is made.
        what: What that is, for the message.

    Raises:
        OSError: The lock beside the folder cannot be had.
    """
    path = folder.parent / f".{folder.name}.lock"
    lock = FileLock(path)
    try:
        try:
            lock.acquire(timeout=0)
        except Timeout:
            print(f"another process is making {what} in {folder}; waiting", file=sys.stderr)
            lock.acquire()
    except NotImplementedError as error:
        raise OSError(f"{folder.parent}: its file system has no locks ({error})") from error
    try:
        yield
        # while it is held, and once the folder is there: whoever has just opened it will see that
        with contextlib.suppress(OSError):
            path.unlink()
    finally:
        lock.release()
