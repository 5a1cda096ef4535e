"""Ways of breaking a copy of a dataset, for the tests of what is said about it."""

import contextlib
import json
import resource

import numpy as np

from samira_warp.io.images import read_image, write_png


def change_json(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def change_arrays(path, **changes):
    """Replace arrays of an npz by functions of them, by new ones, or take them away (None)."""
    with np.load(path) as archive:
        arrays = dict(archive)
    for key, change in changes.items():
        if change is None:
            del arrays[key]
        else:
            arrays[key] = change(arrays[key]) if callable(change) else change
    np.savez(path, **arrays)


def cut(path, *, end=6):
    """Take an image's end away: six bytes are half of the last chunk, which a look at the header does not
    see."""
    path.write_bytes(path.read_bytes()[:-end])


def widen(path):
    """Make an image twice as wide."""
    write_png(path, np.repeat(read_image(path, channels=3), 2, axis=1))


@contextlib.contextmanager
def file_size_limit(size):
    """Writing beyond ``size`` bytes of a file fails, as it does where a disk is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def with_value(value):
    """A copy of an array whose first number is ``value``."""

    def change(array):
        array = array.copy()
        array.flat[0] = value
        return array

    return change
