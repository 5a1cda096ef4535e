"""The tracked FLAME parameters of a VHAP export, read and checked array by array."""

from __future__ import annotations

import zipfile
import zlib
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.data.index import FileIndex
from samira_warp.head.flame import FLAME_VERTICES
from samira_warp.head.model import FrameParameters
from samira_warp.head.teeth import TEETH_VERTICES
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of


class TrackedHead(NamedTuple):
    """Contents of one parameter file."""

    parameters: FrameParameters
    shape: torch.Tensor
    """(n_shape,) float32 identity coefficients."""


def read_tracked_head(path: Path, template: HeadTemplate, index: FileIndex | None = None) -> TrackedHead:
    """Read ``flame_param/*.npz`` or ``canonical_flame_param.npz``.

    Args:
        path: The file.
        template: The head model, which gives the numbers of vertices and coefficients.
        index: Remembers what the file held.

    Raises:
        UserError: The file or a key is missing, an array's shape does not fit the template, or a number is
            not finite.
    """
    arrays = load_parameters(path) if index is None else index.arrays(path, load_parameters)
    vertices = len(template.v_template)

    def vector(key: str, *shape: int) -> torch.Tensor:
        return torch.from_numpy(checked(path, arrays, key, shape)).reshape(shape[-1])

    def coefficients(key: str, *shape: int) -> torch.Tensor:
        """As many as the template's, or the first so many of a template whose shapes have no names."""
        found = arrays[key].shape[-1] if key in arrays and arrays[key].ndim else 0
        fewer = not template.names_expressions and 0 < found < shape[-1]
        return torch.nn.functional.pad(
            vector(key, *shape[:-1], found if fewer else shape[-1]), (0, shape[-1] - found if fewer else 0)
        )

    translation, rotation, neck, jaw, eyes, expression, static_offset, dynamic_offset, shape = all_of(
        partial(vector, "translation", 1, 3),
        partial(vector, "rotation", 1, 3),
        partial(vector, "neck_pose", 1, 3),
        partial(vector, "jaw_pose", 1, 3),
        partial(vector, "eyes_pose", 1, 6),
        partial(coefficients, "expr", 1, template.n_expression),
        partial(_offset, path, arrays, "static_offset", vertices),
        partial(_offset, path, arrays, "dynamic_offset", vertices),
        partial(coefficients, "shape", template.n_shape),
    )
    return TrackedHead(
        FrameParameters(translation, rotation, neck, jaw, eyes, expression, static_offset, dynamic_offset),
        shape,
    )


def load_parameters(path: Path) -> dict[str, np.ndarray]:
    """The plain arrays of an .npz of tracked parameters.

    Raises:
        UserError: The file is missing or broken, or holds pickles.
    """
    if not path.is_file():
        raise UserError(path, expected="tracked parameters", found="no such file")
    try:
        with np.load(path, allow_pickle=False) as archive:
            return dict(archive)
    except (
        ValueError,
        TypeError,
        AttributeError,
        OSError,
        EOFError,
        NotImplementedError,
        zipfile.BadZipFile,
        zlib.error,
    ) as fault:
        raise UserError(path, expected="an .npz of plain arrays", found=fault) from fault


def checked(path: Path, arrays: dict[str, np.ndarray], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """The array under ``key`` as float32, of the shape that the template asks for and finite.

    Raises:
        UserError: It is not.
    """
    if key not in arrays:
        raise UserError(
            path, expected=f"the key {key}", found=f"only {', '.join(sorted(arrays)) or 'an empty archive'}"
        )
    array = arrays[key]
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise UserError(
            f"{path}: {key}",
            expected=f"numbers of shape {shape}",
            found=f"{array.dtype} of shape {array.shape}",
        )
    if not np.isfinite(array).all():
        raise UserError(
            f"{path}: {key}",
            expected="finite numbers",
            found=f"{np.count_nonzero(~np.isfinite(array))} that are not",
        )
    return array.astype(np.float32)


def _offset(path: Path, arrays: dict[str, np.ndarray], key: str, vertices: int) -> torch.Tensor | None:
    """(V, 3) metres, or None where the file has none."""
    return None if key not in arrays else torch.from_numpy(offsets(path, arrays, key, 1, vertices)[0])


def offsets(path: Path, arrays: dict[str, np.ndarray], key: str, count: int, vertices: int) -> np.ndarray:
    """(count, V, 3) metres; FLAME's teeth are added as zeros or left out as the template has it.

    Raises:
        UserError: The array has another shape or is not finite.
    """
    rows = arrays[key].shape[1] if arrays[key].ndim == 3 else vertices
    differ_by_teeth = {rows, vertices} == {FLAME_VERTICES, FLAME_VERTICES + TEETH_VERTICES}
    found = checked(path, arrays, key, (count, rows if differ_by_teeth else vertices, 3))
    return (
        np.pad(found[:, :FLAME_VERTICES], ((0, 0), (0, vertices - FLAME_VERTICES), (0, 0)))
        if differ_by_teeth
        else found
    )
