"""Google's GNM Head (gnm_head.npz, version 3): 17,821 vertices, 253 identities, 383 expressions, 4 joints.

Written from the public description of its arrays and of its model, without the file: see docs/heads.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.head.joints import ROOT
from samira_warp.head.origin import EYES
from samira_warp.head.template import HeadTemplate, template_of
from samira_warp.head.uv_layout import with_one_atlas
from samira_warp.io.npz import read_npz
from samira_warp.support.errors import UserError

KEYS = (
    "template_vertex_positions",
    "template_joint_positions",
    "vertex_identity_basis",
    "expression_basis",
    "expression_names",
    "joint_names",
    "joint_parent_indices",
    "joint_regressor",
    "skinning_weights",
    "pose_correctives_regressor",
    "triangles",
    "triangle_uvs",
    "vertex_groups",
    "vertex_group_names",
)
"""What is read of the file; the first is what it is known by."""

GROUPS = {
    "face": ("hockey_mask",),
    "lips": ("upper_lip", "lower_lip"),
    "mouth": ("mouth_sock", "tongue"),
    "teeth_upper": ("upper_teeth_and_gums",),
    "teeth_lower": ("lower_teeth_and_gums",),
    "left_eyeball": ("left_eye",),
    "right_eyeball": ("right_eye",),
    "left_eye_region": ("left_eye_region",),
    "right_eye_region": ("right_eye_region",),
    "left_ear": ("left_ear",),
    "right_ear": ("right_ear",),
    "nose": ("nose", "nose_region"),
    "forehead": ("forehead", "forehead_region"),
    "scalp": ("scalp", "scalp_region"),
    "neck": ("neck", "neck_region"),
}
"""Our regions' masks, and the vertex groups that each is made of: those of them that the file has."""

MEMBER = 0.5
"""Weight from which a vertex belongs to a group."""

JOINT_ERROR = 1e-3
"""Metres by which regressed joints may miss the file's own: more, and the file means something else."""


def is_gnm(names: tuple[str, ...]) -> bool:
    """Whether an npz file with arrays of these names is GNM's."""
    return KEYS[0] in names


def read_gnm(path: str | Path) -> HeadTemplate:
    """Read GNM Head: its joints below a root of ours, which turns all of it; one atlas; no landmarks.

    Its pose correctives hang on all of its joints, and ours on all but the root: so there is one above the
    neck, at the same place. Its joints move with identity alone, ours with expression as well: where an
    expression moves the vertices that the eyes' joints are regressed from, they go along.

    Raises:
        UserError: The file is missing or broken, an array has a wrong shape or value, or its charts overlap
            and xatlas is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(path, expected="GNM's file gnm_head.npz", found="no such file")
    arrays = read_npz(path, wanted=lambda name: name in KEYS)
    for key in KEYS:
        if key not in arrays:
            raise UserError(f"{path}: {key}", expected="an array", found="no such key")
    _check(path, arrays)
    points = arrays["template_vertex_positions"].astype(np.float64)
    names = [str(name) for name in arrays["joint_names"]]
    joints = arrays["template_joint_positions"]
    eyes = np.mean([joints[names.index(name)] for name in ("left_eye", "right_eye")], axis=0)
    vt, ft = _uvs(arrays["triangles"], arrays["triangle_uvs"])
    shapes = np.concatenate([arrays["vertex_identity_basis"], arrays["expression_basis"]])
    parents = arrays["joint_parent_indices"].astype(np.int64)
    joint_count, count = len(names), len(points)
    template = template_of(
        path,
        {
            "v_template": points + (EYES - eyes),
            "shapedirs": np.moveaxis(shapes, 0, 2),
            "n_shape": np.asarray(len(arrays["vertex_identity_basis"])),
            "posedirs": arrays["pose_correctives_regressor"]
            .reshape(9 * joint_count, count, 3)
            .transpose(1, 2, 0),
            "J_regressor": np.concatenate([arrays["joint_regressor"][:1], arrays["joint_regressor"]]),
            "kintree_table": np.stack([np.append([-1, 0], parents[1:] + 1), np.arange(joint_count + 1)]),
            "weights": np.column_stack([np.zeros(count), arrays["skinning_weights"].T]),
            "f": arrays["triangles"],
            "vt": vt,
            "ft": ft,
            "expression_names": np.array([str(name) for name in arrays["expression_names"]]),
            "joint_names": np.array([ROOT, *names]),
            **{f"mask_{name}": ids for name, ids in _masks(arrays).items()},
        },
    )
    return with_one_atlas(template)


def _check(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Raise UserError unless the arrays that are put together have the shapes that the description gives."""
    count, joints = len(arrays["template_vertex_positions"]), len(arrays["joint_names"])
    faces = len(arrays["triangles"])
    groups = len(arrays["vertex_group_names"])
    shapes = {
        "template_vertex_positions": (count, 3),
        "template_joint_positions": (joints, 3),
        "vertex_identity_basis": (len(arrays["vertex_identity_basis"]), count, 3),
        "expression_basis": (len(arrays["expression_names"]), count, 3),
        "joint_parent_indices": (joints,),
        "joint_regressor": (joints, count),
        "skinning_weights": (joints, count),
        "pose_correctives_regressor": (9 * joints, 3 * count),
        "triangles": (faces, 3),
        "triangle_uvs": (faces, 3, 2),
        "vertex_groups": (groups, count),
    }
    for key, shape in shapes.items():
        if arrays[key].shape != shape or arrays[key].dtype.kind not in "fiu":
            found = f"{arrays[key].dtype} of shape {arrays[key].shape}"
            raise UserError(f"{path}: {key}", expected=f"numbers of shape {shape}", found=found)
    for name in ("left_eye", "right_eye"):
        if name not in [str(joint) for joint in arrays["joint_names"]]:
            raise UserError(f"{path}: joint_names", expected=f"{name} among them", found="none")
    regressed = arrays["joint_regressor"].astype(np.float64) @ arrays["template_vertex_positions"]
    sums = arrays["joint_regressor"].sum(axis=1)
    error = np.abs(regressed - arrays["template_joint_positions"]).max()
    if not (error < JOINT_ERROR and np.abs(sums - 1.0).max() < JOINT_ERROR):
        raise UserError(
            f"{path}: joint_regressor",
            expected="weights that sum to 1 and give template_joint_positions",
            found=f"joints {1000.0 * error:.1f} mm away, sums from {sums.min():.3f} to {sums.max():.3f}",
        )


def _uvs(faces: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 2) UV coordinates and (F, 3) ids of them, from those of each corner (F, 3, 2).

    Corners share one where they have the same vertex and the same coordinates: regions lie over each other in
    some layouts, and would be one chart if coordinates alone counted.
    """
    rows = np.column_stack([faces.ravel(), uvs.reshape(-1, 2)])
    different, ids = np.unique(rows, axis=0, return_inverse=True)
    return different[:, 1:], ids.reshape(faces.shape)


def _masks(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Vertex ids of each region that the file has groups for."""
    groups = dict(zip(map(str, arrays["vertex_group_names"]), arrays["vertex_groups"], strict=True))
    masks = {}
    for name, parts in GROUPS.items():
        present = [groups[part] for part in parts if part in groups]
        if present:
            masks[name] = np.flatnonzero(np.max(present, axis=0) >= MEMBER)
    return masks
