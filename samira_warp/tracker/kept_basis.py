"""A head's smooth functions, kept in the cache folder: they take seconds to find, and heads are few."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from samira_warp.head.smooth_basis import SmoothBasis, smooth_basis
from samira_warp.head.template import HeadTemplate
from samira_warp.io.files import cache_folder, whole_file
from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError

FOLDER = "smooth_bases"
"""Within the cache folder."""


def kept_basis(template: HeadTemplate, count: int) -> SmoothBasis:
    """As `smooth_basis`, found once; where nothing can be kept it is found every time.

    Raises:
        UserError: As `smooth_basis`.
    """
    path = cache_folder() / FOLDER / f"{template.hash[:32]}-{count}.npz"
    kept = _read(path, (len(template.v_template), count))
    if kept is not None:
        return kept
    basis = smooth_basis(template, count)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as fresh, fresh.open("wb") as file:
            np.savez(file, vectors=basis.vectors, eigenvalues=basis.eigenvalues)
    return basis


def _read(path: Path, shape: tuple[int, int]) -> SmoothBasis | None:
    """What was kept, None where there is nothing whole."""
    try:
        arrays = read_npz(path, wanted=SmoothBasis._fields.__contains__)
        basis = SmoothBasis(**arrays)
    except (UserError, TypeError):
        return None
    return basis if basis.vectors.shape == shape else None
