"""Numbers out of other people's files, checked as they are taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.support.errors import UserError


def numbers(place: object, value: object, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """A float64 array of finite numbers.

    Args:
        place: File and key, for what is said about them.
        value: Nested lists of a JSON document, or an array; axes of length 1 count for nothing.
        shape: What is wanted without axes of length 1, None for any vector.

    Raises:
        UserError: ``value`` is something else.
    """
    wanted = "a vector of numbers" if shape is None else f"numbers of shape {shape}"
    try:
        array = np.asarray(value)
    except ValueError as fault:
        raise UserError(place, expected=wanted, found="rows of unequal length") from fault
    if array.dtype.kind not in "fiu":
        raise UserError(place, expected=wanted, found="none" if value is None else f"{array.dtype}")
    flat = np.squeeze(array)
    if shape is None:
        flat = np.atleast_1d(flat)
    if flat.ndim != 1 if shape is None else flat.shape != tuple(size for size in shape if size != 1):
        raise UserError(place, expected=wanted, found=f"shape {array.shape}")
    if not np.isfinite(flat).all():
        raise UserError(
            place, expected="finite numbers", found=f"{np.count_nonzero(~np.isfinite(flat))} that are not"
        )
    return flat.reshape(flat.shape if shape is None else shape).astype(np.float64)


def stacked(path: Path, rows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Rows of arrays by name as arrays of rows.

    Raises:
        UserError: The arrays of a name differ in size.
    """
    for row in rows:
        for key, value in row.items():
            if value.shape != rows[0][key].shape:
                raise UserError(
                    f"{path}: {key}",
                    expected=f"{rows[0][key].size} numbers in every frame",
                    found=f"{value.size} in one",
                )
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


def world_to_camera(place: object, value: object) -> np.ndarray:
    """(4, 4) of a rigid transform written as 3 x 4 or 4 x 4.

    Raises:
        UserError: ``value`` is something else.
    """
    rows = numbers(place, value, (4, 4) if np.asarray(value, object).size == 16 else (3, 4))
    matrix = np.concatenate([rows[:3], [[0.0, 0.0, 0.0, 1.0]]])
    check_rotation(place, matrix[:3, :3])
    return matrix


def check_rotation(place: object, rotation: np.ndarray) -> None:
    """Raise UserError unless a (3, 3) matrix is a rotation.

    A tolerance of 1e-3 lets pass what was written with four decimals.
    """
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise UserError(place, expected="a rotation", found=rotation.round(4).tolist())
