"""The tracked parameters of a VHAP export, read and checked array by array.

A file holds translation, rotation, neck_pose, jaw_pose, eyes_pose, expr, shape, and perhaps static_offset and
dynamic_offset. Of the poses it needs those of the template's joints; joints that FLAME does not have are
posed by ``pose_<joint>``.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from samira_warp.data.index import FileIndex
from samira_warp.data.joints import FLAME_KEYS, OTHER_KEY, pose_keys, rotations_on
from samira_warp.head.flame import FLAME_VERTICES
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.teeth import TEETH_VERTICES
from samira_warp.head.template import HeadTemplate
from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of

_KEYS = ("translation", "expr", "shape", "static_offset", "dynamic_offset")
"""What is read of a file beside the poses."""


class ParameterFile(NamedTuple):
    """Contents of one parameter file; float32."""

    parameters: FrameParameters
    """One frame's, without the static offset."""
    shape: Tensor
    """(n_shape,) identity coefficients."""
    static_offset: Tensor | None
    """(V, 3) metres, None where the file has none."""


def read_parameter_file(path: Path, template: HeadTemplate, index: FileIndex | None = None) -> ParameterFile:
    """Read ``flame_param/*.npz`` or ``canonical_flame_param.npz``.

    Args:
        path: The file.
        template: The head, which gives the joints and the numbers of vertices and coefficients.
        index: Remembers what the file held.

    Raises:
        UserError: The file or a key is missing, an array's shape does not fit the template, a number is not
            finite, or a joint turns that the template does not have.
    """
    arrays = load_parameters(path) if index is None else index.arrays(path, load_parameters)
    vertices = len(template.v_template)

    def vector(key: str, *shape: int) -> Tensor:
        return torch.from_numpy(checked(path, arrays, key, shape)).reshape(shape[-1])

    def coefficients(key: str, *shape: int) -> Tensor:
        """As many as the template's, or the first so many of a template whose shapes have no names."""
        found = arrays[key].shape[-1] if key in arrays and arrays[key].ndim else 0
        fewer = not template.names_expressions and 0 < found < shape[-1]
        return torch.nn.functional.pad(
            vector(key, *shape[:-1], found if fewer else shape[-1]), (0, shape[-1] - found if fewer else 0)
        )

    def rotations() -> Tensor:
        return torch.from_numpy(
            rotations_on(template, read_poses(path, arrays, template, count=1), place=path)[0]
        )

    translation, joints, expression, static_offset, dynamic_offset, shape = all_of(
        partial(vector, "translation", 1, 3),
        rotations,
        partial(coefficients, "expr", 1, template.n_expression),
        partial(_offset, path, arrays, "static_offset", vertices),
        partial(_offset, path, arrays, "dynamic_offset", vertices),
        partial(coefficients, "shape", template.n_shape),
    )
    return ParameterFile(
        FrameParameters(translation, joints, expression, dynamic_offset), shape, static_offset
    )


def read_poses(
    path: Path, arrays: dict[str, np.ndarray], template: HeadTemplate, *, count: int
) -> dict[str, np.ndarray]:
    """(count, 3) float32 axis-angle by joint, of all that the template needs and all that is there.

    Raises:
        UserError: A key is missing, or an array has another shape or is not finite.
    """
    keys = pose_keys(arrays, template)
    found = all_of(
        *(partial(checked, path, arrays, key, (count, 3 * len(names))) for key, names in keys.items())
    )
    poses: dict[str, np.ndarray] = {}
    for names, array in zip(keys.values(), found, strict=True):
        poses |= dict(zip(names, np.split(array, len(names), axis=1), strict=True))
    return poses


def load_parameters(path: Path, *, also: Collection[str] = ()) -> dict[str, np.ndarray]:
    """The arrays of an .npz of tracked parameters that say something of the head.

    Args:
        path: The file.
        also: Other entries that are wanted, where they are there.

    Raises:
        UserError: The file is missing or broken, or an array that is wanted is, or is a pickle.
    """
    if not path.is_file():
        raise UserError(path, expected="tracked parameters", found="no such file")
    keys = {*_KEYS, *FLAME_KEYS, *also}
    return read_npz(path, wanted=lambda key: key in keys or key.startswith(OTHER_KEY))


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


def _offset(path: Path, arrays: dict[str, np.ndarray], key: str, vertices: int) -> Tensor | None:
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
