"""The parametric head's template: FLAME's keys in an npz file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from samira_warp.head.joints import FLAME_JOINTS, ROOT, default_head_joint
from samira_warp.head.landmarks import LandmarkEmbedding, checked_embedding
from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError


@dataclass(frozen=True, eq=False)
class HeadTemplate:
    """A head in FLAME's layout with any number of vertices, shapes and joints.

    Lengths are metres; +z points out of the face, +y up.

    Attributes:
        v_template: (V, 3) float32 mean head.
        shapedirs: (V, 3, S + E) float32 linear shapes: identity first, then expression.
        n_shape: S, how many of them are identity.
        posedirs: (V, 3, 9 (J - 1)) float32 correctives for the entries of the rotations of all joints but the
            root less the identity.
        joint_regressor: (J, V) float32 joint locations from vertices.
        parents: (J,) int32 parent of each joint, which precedes it, -1 for the first, the root.
        weights: (V, J) float32 skinning weights, each row summing to 1.
        faces: (F, 3) int32 vertex ids.
        vt: (T, 2) float32 UV coordinates, u to the right and v up.
        ft: (F, 3) int32 ids of the faces' UV coordinates.
        masks: Vertex ids (int32) of each named region, as the file has them: they may overlap and leave
            vertices out.
        expression_names: E names.
        joint_names: J names, all different; FLAME's are `FLAME_JOINTS`.
        head_joint: Name of the joint that carries the head.
        landmarks: Where the landmarks that detectors find lie on it, or None where nobody has placed them.
    """

    v_template: np.ndarray
    shapedirs: np.ndarray
    n_shape: int
    posedirs: np.ndarray
    joint_regressor: np.ndarray
    parents: np.ndarray
    weights: np.ndarray
    faces: np.ndarray
    vt: np.ndarray
    ft: np.ndarray
    masks: dict[str, np.ndarray]
    expression_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    head_joint: str
    landmarks: LandmarkEmbedding | None = None

    @property
    def n_expression(self) -> int:
        """E, how many of the linear shapes are expression."""
        return self.shapedirs.shape[2] - self.n_shape

    @property
    def names_expressions(self) -> bool:
        """Whether expressions have names of their own, not the numbers that a file without names gets."""
        return self.expression_names[:1] != (_unnamed(0),)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the content in hexadecimal: equal for equal heads, whatever the file was like.

        Landmarks do not count: they find a head in pictures, and pose none.
        """
        digest = hashlib.sha256()
        for key, value in sorted(_to_arrays(self).items()):
            value = np.ascontiguousarray(value)
            digest.update(f"{key} {value.dtype.str} {value.shape}\n".encode())
            digest.update(value.tobytes())
        return digest.hexdigest()


def read_template(path: str | Path) -> HeadTemplate:
    """Read and check a template.

    The file holds v_template, shapedirs, n_shape, posedirs, J_regressor, kintree_table, weights, f, vt and ft
    as `HeadTemplate` describes them, and optionally expression_names, any number of mask_<region>,
    joint_names and head_joint, and landmark_ids, landmark_faces and landmark_barycentrics together. Without
    joint_names the joints are FLAME's five; without head_joint the head is carried by the joint "head", else
    "neck", else the root. Nothing in it is unpickled.

    Raises:
        UserError: The file is missing, is no npz, or a key is missing or has a wrong shape, an index out of
            range or a value that is not finite; the message names the file, the key, what was expected and
            what was found.
    """
    path = Path(path)
    return template_of(path, load_arrays(path))


def template_of(path: Path, arrays: Mapping[str, np.ndarray]) -> HeadTemplate:
    """Check a template's arrays and keep them.

    Args:
        path: Where they were read, for what is said about them.
        arrays: As `read_template` says that a file holds them.

    Raises:
        UserError: As in read_template.
    """
    reader = _Reader(path, arrays)
    v_template = reader.numbers("v_template", (None, 3))
    vertices = len(v_template)
    reader.expect("v_template", vertices > 0, "at least one vertex", "none")
    shapedirs = reader.numbers("shapedirs", (vertices, 3, None))
    n_shape = int(reader.integers("n_shape", (), low=0, high=shapedirs.shape[2] + 1))
    joint_names = reader.joint_names()
    joints = len(joint_names)
    weights = reader.numbers("weights", (vertices, joints))
    reader.expect("weights", np.abs(weights.sum(axis=1) - 1).max() < 1e-3, "rows that sum to 1", "other sums")
    faces = reader.integers("f", (None, 3), low=0, high=vertices)
    reader.expect("f", len(faces) > 0, "at least one face", "none")
    vt = reader.numbers("vt", (None, 2))
    return HeadTemplate(
        v_template=v_template,
        shapedirs=shapedirs,
        n_shape=n_shape,
        posedirs=reader.numbers("posedirs", (vertices, 3, 9 * (joints - 1))),
        joint_regressor=reader.numbers("J_regressor", (joints, vertices)),
        parents=reader.parents(joints),
        weights=weights,
        faces=faces,
        vt=vt,
        ft=reader.integers("ft", (len(faces), 3), low=0, high=len(vt)),
        masks={
            key.removeprefix(_MASK): reader.integers(key, (None,), low=0, high=vertices)
            for key in sorted(reader.arrays)
            if key.startswith(_MASK)
        },
        expression_names=reader.names("expression_names", shapedirs.shape[2] - n_shape),
        joint_names=joint_names,
        head_joint=reader.head_joint(joint_names),
        landmarks=reader.landmarks(len(faces)),
    )


def save_template(template: HeadTemplate, path: str | Path) -> None:
    """Write a template in the layout that `read_template` reads, at exactly ``path``."""
    with Path(path).open("wb") as file:
        arrays: dict[str, Any] = _to_arrays(template) | _landmark_arrays(template.landmarks)
        np.savez_compressed(file, **arrays)


_LANDMARK_KEYS = ("landmark_ids", "landmark_faces", "landmark_barycentrics")
"""A file has all of them or none, in the order of `LandmarkEmbedding`'s fields."""

_KEYS = frozenset(
    (
        *("v_template", "shapedirs", "n_shape", "posedirs", "J_regressor", "kintree_table", "weights"),
        *("f", "vt", "ft", "expression_names", "joint_names", "head_joint"),
        *_LANDMARK_KEYS,
    )
)
"""What is read of a file beside the masks."""

_MASK = "mask_"
"""What precedes a region's name."""


def _unnamed(index: int) -> str:
    return f"expression_{index:03d}"


def _to_arrays(template: HeadTemplate) -> dict[str, np.ndarray]:
    """The file's content; what joints are called is left out where it is what a file without it means.

    So FLAME's heads have the hashes that they had before joints had names.
    """
    names = {}
    if template.joint_names != FLAME_JOINTS:
        names["joint_names"] = np.asarray(template.joint_names, np.str_)
    if template.head_joint != default_head_joint(template.joint_names):
        names["head_joint"] = np.asarray(template.head_joint, np.str_)
    return {
        "v_template": template.v_template,
        "shapedirs": template.shapedirs,
        "n_shape": np.asarray(template.n_shape, np.int64),
        "posedirs": template.posedirs,
        "J_regressor": template.joint_regressor,
        "kintree_table": np.stack([template.parents, np.arange(len(template.parents), dtype=np.int32)]),
        "weights": template.weights,
        "f": template.faces,
        "vt": template.vt,
        "ft": template.ft,
        "expression_names": np.asarray(template.expression_names, np.str_),
        **{f"{_MASK}{name}": ids for name, ids in template.masks.items()},
        **names,
    }


def _landmark_arrays(landmarks: LandmarkEmbedding | None) -> dict[str, np.ndarray]:
    """What the file has beside what the head is made of."""
    if landmarks is None:
        return {}
    return dict(zip(_LANDMARK_KEYS, (landmarks.ids, landmarks.faces, landmarks.barycentrics), strict=True))


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an npz file that a head is made of, none of them unpickled.

    Raises:
        UserError: The file is missing, is a pickle, or an array that a head is made of cannot be read.
    """
    if path.suffix.lower() in {".pkl", ".pickle"}:
        raise UserError(
            path,
            expected="an npz file with FLAME's keys",
            found="a pickle, which may run code when it is read",
        )
    if not path.is_file():
        raise UserError(path, expected="an npz file with FLAME's keys", found="no such file")
    return read_npz(path, wanted=lambda key: key in _KEYS or key.startswith(_MASK))


@dataclass(frozen=True)
class _Reader:
    """Arrays of one head, each checked as it is taken; every complaint names the file and the key."""

    path: Path
    arrays: Mapping[str, np.ndarray]

    def expect(self, key: str, holds: bool | np.bool_, expected: str, found: str) -> None:
        if not holds:
            raise UserError(f"{self.path}: {key}", expected=expected, found=found)

    def take(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        wanted = f"({', '.join('any' if size is None else str(size) for size in shape)})"
        self.expect(key, key in self.arrays, f"an array of shape {wanted}", "no such key")
        array = self.arrays[key]
        fits = array.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, array.shape, strict=True)
        )
        self.expect(key, fits, f"shape {wanted}", f"shape {array.shape}")
        return array

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        array = self.take(key, shape)
        self.expect(key, array.dtype.kind in "fiu", "numbers", f"{array.dtype}")
        self.expect(key, np.isfinite(array).all(), "finite numbers", "NaN or infinity")
        return np.ascontiguousarray(array, np.float32)

    def integers(self, key: str, shape: tuple[int | None, ...], *, low: int, high: int) -> np.ndarray:
        """Integers from ``low`` to ``high`` - 1."""
        array = self.take(key, shape)
        self.expect(key, array.dtype.kind in "iu", "integers", f"{array.dtype}")
        if array.size:
            found = f"{array.min()} to {array.max()}"
            self.expect(
                key, low <= array.min() and array.max() < high, f"integers from {low} to {high - 1}", found
            )
        return array.astype(np.int32)

    def parents(self, joints: int) -> np.ndarray:
        """Row 0 of the kinematic tree; FLAME's files mark the root's parent by the largest uint32."""
        table = self.take("kintree_table", (2, joints))
        self.expect("kintree_table", table.dtype.kind in "iu", "integers", f"{table.dtype}")
        parents = table[0].astype(np.int64)
        parents[0] = -1
        precede = all(0 <= parents[joint] < joint for joint in range(1, joints))
        wanted = "parents that precede their joints, after one root"
        self.expect("kintree_table", precede, wanted, f"{parents.tolist()}")
        return parents.astype(np.int32)

    def names(self, key: str, count: int) -> tuple[str, ...]:
        if key not in self.arrays:
            return tuple(map(_unnamed, range(count)))
        return self.text(key, count)

    def joint_names(self) -> tuple[str, ...]:
        """The template's own names for its joints, or FLAME's."""
        if "joint_names" not in self.arrays:
            joints = len(self.take("J_regressor", (None, None)))
            known = joints == len(FLAME_JOINTS)
            self.expect("joint_names", known, f"names of the {joints} joints of J_regressor", "no such key")
            return FLAME_JOINTS
        names = self.text("joint_names", None)
        self.expect("joint_names", len(names) > 0 and all(names), "a name for each joint", f"{names}")
        self.expect("joint_names", len(set(names)) == len(names), "names that differ", f"{names}")
        self.expect("joint_names", ROOT not in names[1:], f"no {ROOT} but the first joint", f"{names}")
        return names

    def head_joint(self, joint_names: tuple[str, ...]) -> str:
        """The joint that carries the head, by the template's own word or without one."""
        if "head_joint" not in self.arrays:
            return default_head_joint(joint_names)
        name = str(self.take("head_joint", ()))
        self.expect("head_joint", name in joint_names, f"one of {', '.join(joint_names)}", repr(name))
        return name

    def landmarks(self, faces: int) -> LandmarkEmbedding | None:
        """The template's landmarks; a file has all their keys or none."""
        present = [key for key in _LANDMARK_KEYS if key in self.arrays]
        if not present:
            return None
        for key in _LANDMARK_KEYS:
            self.expect(key, key in present, f"an array beside {present[0]}", "no such key")
        return checked_embedding(self.path, {key: self.arrays[key] for key in _LANDMARK_KEYS}, faces)

    def text(self, key: str, count: int | None) -> tuple[str, ...]:
        array = self.take(key, (count,))
        self.expect(key, array.size == 0 or array.dtype.kind == "U", "text", f"{array.dtype}")
        return tuple(str(name) for name in array)
