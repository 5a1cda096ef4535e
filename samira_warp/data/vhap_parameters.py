"""The tracked FLAME parameters of a VHAP export, read and checked array by array."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from samira_warp.errors import UserError
from samira_warp.head.model import FrameParameters
from samira_warp.head.template import HeadTemplate

FLAME_VERTICES = 5023
"""Vertices of FLAME."""

FLAME_TEETH_VERTICES = 120
"""What VHAP appends to FLAME's vertices; a static offset may come with or without them."""


class TrackedHead(NamedTuple):
    """Contents of one parameter file."""

    parameters: FrameParameters
    shape: torch.Tensor
    """(n_shape,) float32 identity coefficients."""


def read_tracked_head(path: Path, template: HeadTemplate) -> TrackedHead:
    """Read ``flame_param/*.npz`` or ``canonical_flame_param.npz``.

    Args:
        path: The file.
        template: The head model, which gives the numbers of vertices and coefficients.

    Raises:
        UserError: The file or a key is missing, an array's shape does not fit the template, or a number is not finite.
    """
    arrays = _load(path)
    vertices = len(template.v_template)

    def vector(key: str, *shape: int) -> torch.Tensor:
        return torch.from_numpy(_checked(path, arrays, key, shape)).reshape(shape[-1])

    parameters = FrameParameters(
        translation=vector("translation", 1, 3),
        rotation=vector("rotation", 1, 3),
        neck=vector("neck_pose", 1, 3),
        jaw=vector("jaw_pose", 1, 3),
        eyes=vector("eyes_pose", 1, 6),
        expression=vector("expr", 1, template.n_expression),
        static_offset=_offset(path, arrays, "static_offset", vertices),
        dynamic_offset=_offset(path, arrays, "dynamic_offset", vertices),
    )
    return TrackedHead(parameters, vector("shape", template.n_shape))


def _load(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise UserError(path, expected="tracked parameters", found="no such file")
    try:
        with np.load(path, allow_pickle=False) as archive:
            return dict(archive)
    except (ValueError, TypeError, AttributeError, OSError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as fault:
        raise UserError(path, expected="an .npz of plain arrays", found=fault) from fault


def _checked(path: Path, arrays: dict[str, np.ndarray], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """The array under ``key`` as float32, of the shape that the template asks for and finite."""
    if key not in arrays:
        raise UserError(path, expected=f"the key {key}", found=f"only {', '.join(sorted(arrays)) or 'an empty archive'}")
    array = arrays[key]
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise UserError(f"{path}: {key}", expected=f"numbers of shape {shape}", found=f"{array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise UserError(f"{path}: {key}", expected="finite numbers", found=f"{np.count_nonzero(~np.isfinite(array))} that are not")
    return array.astype(np.float32)


def _offset(path: Path, arrays: dict[str, np.ndarray], key: str, vertices: int) -> torch.Tensor | None:
    """(V, 3) metres, or None where the file has none; FLAME's teeth are added as zeros or left out as the template has it."""
    if key not in arrays:
        return None
    rows = arrays[key].shape[1] if arrays[key].ndim == 3 else vertices
    with_teeth = FLAME_VERTICES + FLAME_TEETH_VERTICES
    differ_by_teeth = {rows, vertices} == {FLAME_VERTICES, with_teeth}
    offset = _checked(path, arrays, key, (1, rows if differ_by_teeth else vertices, 3))[0]
    if differ_by_teeth:
        offset = np.concatenate([offset[:FLAME_VERTICES], np.zeros((vertices - FLAME_VERTICES, 3), np.float32)])
    return torch.from_numpy(offset)
