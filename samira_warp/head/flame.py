"""FLAME 2020 and 2023 from the user's own file.

Li et al., "Learning a model of facial shape and expression from 4D scans", 2017.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from samira_warp.head.flame_companions import (
    check_ids,
    checked_uvs,
    read_eyelids,
    read_landmarks,
    read_masks,
    read_uvs,
)
from samira_warp.head.joints import FLAME_JOINTS
from samira_warp.head.teeth import add_teeth
from samira_warp.head.template import HeadTemplate, load_arrays, template_of
from samira_warp.io.pickles import arrays_of, read_pickle
from samira_warp.support.errors import UserError

FLAME_VERTICES = 5023
"""Vertices of FLAME; VHAP and GaussianAvatars append `TEETH_VERTICES`."""

FLAME_FACES = 9976
"""Triangles of FLAME."""

FLAME_IDENTITY = 300
"""How many of FLAME's linear shapes are identity; expression follows, both by falling variance."""

EYELIDS = ("eyelid_left", "eyelid_right")
"""Names of the two expression shapes that metrical-tracker's eyelids become, the last ones."""

_KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "kintree_table", "weights", "f")


def read_flame(path: str | Path) -> HeadTemplate:
    """Read FLAME, add UV coordinates, regions and teeth, and eyelids and landmarks where they are given.

    Args:
        path: FLAME's pickle as it is downloaded (generic_model.pkl, flame2023.pkl, ...), or an .npz of the
            same keys, which may hold vt and ft as well. The other files are looked for beside it, by the
            names in `flame_companions`.

    Returns:
        A head of 5143 vertices and 10144 faces with 300 identity shapes. Expression is FLAME's, then the two
        eyelids if there are any.

    Raises:
        UserError: A file is missing or broken, is not FLAME's, or names anything but arrays.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(
            path,
            expected="FLAME's file (.pkl or .npz)",
            found="a folder" if path.is_dir() else "no such file",
        )
    return _completed(path, load_arrays(path) if path.suffix.lower() == ".npz" else read_pickle(path))


def _completed(path: Path, values: object) -> HeadTemplate:
    """FLAME's own values with what is beside them."""
    arrays = arrays_of(path, values, _KEYS)
    _check_layout(path, arrays)
    size = {"vertices": FLAME_VERTICES, "faces": FLAME_FACES}
    own_faces = arrays["f"]
    if isinstance(values, dict) and "vt" in values and "ft" in values:
        arrays |= checked_uvs(path, arrays_of(path, values, ("vt", "ft")), **size)
    else:
        arrays |= read_uvs(path.parent, **size)
    arrays |= read_masks(path.parent, vertices=FLAME_VERTICES)
    arrays = add_teeth(arrays, n_shape=FLAME_IDENTITY)
    landmarks = read_landmarks(path.parent, own_faces, arrays["f"])
    eyelids = read_eyelids(path.parent, vertices=FLAME_VERTICES)
    names = [f"expression_{index:03d}" for index in range(arrays["shapedirs"].shape[2] - FLAME_IDENTITY)]
    if eyelids is not None:
        rest = len(arrays["v_template"]) - FLAME_VERTICES
        arrays["shapedirs"] = np.concatenate(
            [arrays["shapedirs"], np.pad(eyelids, ((0, rest), (0, 0), (0, 0)))], axis=2
        )
        names += EYELIDS
    template = template_of(
        path, {**arrays, "n_shape": np.asarray(FLAME_IDENTITY), "expression_names": np.array(names)}
    )
    return dataclasses.replace(template, landmarks=landmarks)


def _check_layout(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Raise UserError unless the arrays that others are appended to have FLAME's shapes."""
    joints = len(FLAME_JOINTS)
    shapes = {
        "v_template": (FLAME_VERTICES, 3),
        "posedirs": (FLAME_VERTICES, 3, 9 * (joints - 1)),
        "J_regressor": (joints, FLAME_VERTICES),
        "weights": (FLAME_VERTICES, joints),
        "f": (FLAME_FACES, 3),
    }
    for key, shape in shapes.items():
        if arrays[key].shape != shape or arrays[key].dtype.kind not in "fiu":
            raise UserError(
                f"{path}: {key}", expected=f"FLAME's numbers of shape {shape}", found=_kind(arrays[key])
            )
    check_ids(f"{path}: f", arrays["f"], FLAME_VERTICES)
    dirs = arrays["shapedirs"]
    if (
        dirs.ndim != 3
        or dirs.shape[:2] != (FLAME_VERTICES, 3)
        or dirs.shape[2] <= FLAME_IDENTITY
        or dirs.dtype.kind != "f"
    ):
        wanted = (
            f"numbers of shape ({FLAME_VERTICES}, 3, 400): {FLAME_IDENTITY} identity shapes, then expression"
        )
        raise UserError(f"{path}: shapedirs", expected=wanted, found=_kind(dirs))


def _kind(array: np.ndarray) -> str:
    return f"{array.dtype} of shape {array.shape}"
