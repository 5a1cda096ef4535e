"""The one exception that stands for a user's mistake, and words for the system's own."""

from __future__ import annotations

import errno


class UserError(ValueError):
    """Input that cannot be used: the message says where, what was expected and what was found.

    Where is the file's or the argument's name. The command line prints the message on one line of standard
    error and exits with status 2; from Python it is an ordinary ValueError.

    Attributes:
        subject: The file or argument.
        expected: What was expected, folded to one line.
        found: What was found, folded to one line.
    """

    def __init__(self, subject: object, *, expected: object, found: object) -> None:
        """Compose ``subject: expected ..., found ...``, folded to one line."""
        self.subject, self.expected, self.found = (
            " ".join(str(part).split()) for part in (subject, expected, found)
        )
        super().__init__(f"{self.subject}: expected {self.expected}, found {self.found}")


_SENTENCES = {
    errno.ENOENT: "expected a file or folder, found none of this name",
    errno.EACCES: "may not be read or written by this user",
    errno.EPERM: "may not be changed by this user",
    errno.EROFS: "cannot be written: its file system is read-only",
    errno.ENOSPC: "cannot be written: the disk is full",
    errno.EDQUOT: "cannot be written: this user's share of the disk is full",
    errno.EFBIG: "cannot be written: the file would be larger than is allowed",
    errno.EISDIR: "expected a file, found a folder",
    errno.ENOTDIR: "expected a folder, found a file on the way to it",
    errno.EEXIST: "cannot be made: something of this name is there",
    errno.ENOTEMPTY: "cannot be replaced: the folder is not empty",
    errno.ENAMETOOLONG: "cannot be made: the name is too long",
    errno.EMFILE: "cannot be opened: too many files are open (ulimit -n)",
    errno.EIO: "cannot be read or written: the disk reports an error",
}
"""What a failed call of the system means for the file it was made for."""


def in_words(error: OSError) -> str:
    """A sentence for an OSError: the file, and what could not be done with it.

    One that was raised with words of its own keeps them.
    """
    names = [str(name) for name in (error.filename, error.filename2) if name is not None]
    if error.errno is None or not (names or error.errno in _SENTENCES):
        return str(error) or f"a file cannot be read or written ({type(error).__name__})"
    return f"{' to '.join(names) or 'a file of this run'}: {reason(error)}"


def reason(error: OSError) -> str:
    """What could not be done, without the file."""
    if error.errno is None:
        return str(error)
    return f"{_SENTENCES.get(error.errno, 'cannot be read or written')} ({error.strerror})"
