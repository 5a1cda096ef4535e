"""ICT-FaceKit's light face model (Li et al., Learning Formation of Physically-Based Face Attributes, 2020).

The folder ``FaceXModel`` of its release: a neutral mesh, 100 modes of identity and expressions named after
ARKit's, each a Wavefront file of the whole mesh at one coefficient of 1. Its README gives the numbers of the
vertices of each part.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from samira_warp.head.ict_regions import KEPT, PARTS, VERTICES, regions_of
from samira_warp.head.origin import EYES
from samira_warp.head.placed_landmarks import placed_landmarks
from samira_warp.head.template import HeadTemplate
from samira_warp.head.uv_layout import repacked
from samira_warp.io.wavefront import read_mesh, read_vertices
from samira_warp.support.errors import UserError

NEUTRAL = "generic_neutral_mesh.obj"
"""The file by which a folder is known."""

NOT_EXPRESSIONS = ("generic_neutral_mesh", "identity", "PupilDilate")
"""How the names of the other files begin; pupils are within the eyeballs, which are not kept."""

SCALE = 0.01
"""Metres of its unit."""

JOINTS = ("root", "neck", "left_eye", "right_eye")
"""There is no jaw: jawOpen and its kin are expressions, which move the teeth along."""

ROOT_AT, NECK_AT = np.array([0.0, -0.210, -0.080]), np.array([0.0, -0.140, -0.085])
"""From the middle between the eyeballs, metres: in the neck at its foot, and below the skull."""

NECK_BENDS = (-0.210, -0.145)
"""Heights from the eyes between which the neck's skin passes from the root's to the neck's."""

SUPPORT = 100
"""Vertices that the joints in the neck are regressed from."""

FILE = "ict_face_mesh.csv"
"""Where the landmarks lie on the neutral mesh, as `tools/place_landmarks.py` placed them."""


class _Files(NamedTuple):
    """What is read of a folder: names of shapes and their files, in order."""

    identity: list[Path]
    expression: list[Path]


def is_ict(path: Path) -> bool:
    """Whether a folder is ICT-FaceKit's model, or has it in FaceXModel as the release does."""
    return any((folder / NEUTRAL).is_file() for folder in _folders(path))


def read_ict(path: str | Path) -> HeadTemplate:
    """Read the model: metres, its middle in the skull, one atlas, landmarks.

    Lacrimal fluid, eye blend, eye occlusion, lashes and what lies within the eyeballs are left out: they are
    clear layers and strips that a renderer's shaders want. The files of the 100 identities and of all
    expressions are read, 400 MB of text, in some ten seconds.

    Args:
        path: The folder FaceXModel, or the release's above it.

    Raises:
        UserError: A file is missing or broken, has another number of vertices, or xatlas is not installed.
    """
    folder = next((folder for folder in _folders(Path(path)) if (folder / NEUTRAL).is_file()), None)
    if folder is None:
        raise UserError(path, expected=f"ICT-FaceKit's folder FaceXModel, with {NEUTRAL}", found="none")
    mesh = read_mesh(folder / NEUTRAL)
    _check_vertices(folder / NEUTRAL, mesh.vertices)
    if (mesh.uv_faces < 0).any():
        raise UserError(folder / NEUTRAL, expected="UV coordinates at every corner", found="corners without")
    files = _files(folder)
    shapes = _shapes(files, mesh.vertices)
    number = np.full(VERTICES, -1)
    number[KEPT] = np.arange(len(KEPT))
    kept = (number[mesh.faces] >= 0).all(axis=1)
    eyes = np.stack(
        [_ball_center(mesh.vertices[slice(*PARTS[name])]) for name in ("left_eyeball", "right_eyeball")]
    )
    points = SCALE * (mesh.vertices[KEPT] - eyes.mean(axis=0)) + EYES
    faces = number[mesh.faces[kept]]
    joints = np.stack([EYES + ROOT_AT, EYES + NECK_AT, *(SCALE * (eyes - eyes.mean(axis=0)) + EYES)])
    template = HeadTemplate(
        v_template=points.astype(np.float32),
        shapedirs=shapes,
        n_shape=len(files.identity),
        posedirs=np.zeros((len(points), 3, 9 * (len(JOINTS) - 1)), np.float32),
        joint_regressor=_regressor(points, joints, number).astype(np.float32),
        parents=np.array([-1, 0, 1, 1], np.int32),
        weights=_weights(points, number).astype(np.float32),
        faces=faces.astype(np.int32),
        vt=mesh.uvs.astype(np.float32),
        ft=mesh.uv_faces[kept].astype(np.int32),
        masks={name: number[ids].astype(np.int32) for name, ids in regions_of(mesh.vertices).items()},
        expression_names=tuple(file.stem for file in files.expression),
        joint_names=JOINTS,
        head_joint="neck",
        landmarks=placed_landmarks(FILE, "samira_warp.head", points, faces),
    )
    return repacked(template)


def _folders(path: Path) -> tuple[Path, Path]:
    return path, path / "FaceXModel"


def _files(folder: Path) -> _Files:
    """Identities by number, expressions by name: all that are there."""
    found = sorted(folder.glob("*.obj"))
    identity = [file for file in found if file.stem.startswith("identity")]
    expression = [file for file in found if not file.stem.startswith(NOT_EXPRESSIONS)]
    for what, files in (
        ("identity000.obj and on", identity),
        ("expressions such as jawOpen.obj", expression),
    ):
        if not files:
            raise UserError(folder, expected=what, found="none")
    return _Files(identity, expression)


def _shapes(files: _Files, neutral: np.ndarray) -> np.ndarray:
    """(V, 3, S + E) float32 metres of the vertices that are kept."""
    paths = [*files.identity, *files.expression]
    shapes = np.empty((len(KEPT), 3, len(paths)), np.float32)

    def read(index: int) -> None:
        vertices = read_vertices(paths[index])
        _check_vertices(paths[index], vertices)
        shapes[:, :, index] = SCALE * (vertices - neutral)[KEPT]

    with ThreadPoolExecutor() as pool:
        list(pool.map(read, range(len(paths))))
    return shapes


def _check_vertices(path: Path, vertices: np.ndarray) -> None:
    if len(vertices) != VERTICES:
        raise UserError(path, expected=f"the {VERTICES} vertices of ICT-FaceKit", found=len(vertices))


def _ball_center(points: np.ndarray) -> np.ndarray:
    """(3,) centre of the sphere that fits the back half of an eyeball best; the cornea stands out in front.

    For |p|^2 = 2 p c + (r^2 - |c|^2) is linear in c and the rest.
    """
    back = points[points[:, 2] < np.median(points[:, 2])]
    system = np.column_stack([2.0 * back, np.ones(len(back))])
    return np.linalg.lstsq(system, (back**2).sum(axis=1), rcond=None)[0][:3]


def _weights(points: np.ndarray, number: np.ndarray) -> np.ndarray:
    """(V, 4) skinning: eyeballs with their joints, the neck's skin passing from the root to the neck."""
    low, high = (EYES[1] + height for height in NECK_BENDS)
    share = np.clip((points[:, 1] - low) / (high - low), 0.0, 1.0)
    head = share * share * (3.0 - 2.0 * share)
    weights = np.column_stack([1.0 - head, head, np.zeros((len(points), 2))])
    for joint, name in ((2, "left_eyeball"), (3, "right_eyeball")):
        weights[number[slice(*PARTS[name])]] = np.eye(4)[joint]
    return weights


def _regressor(points: np.ndarray, joints: np.ndarray, number: np.ndarray) -> np.ndarray:
    """(4, V) weights, summing to 1, that give the joints from the vertices.

    Those of the neck come from the skin all round at their height, those of the eyes from their eyeballs.
    """
    skin = number[slice(*PARTS["face"])], number[slice(*PARTS["head"])]
    regressor = np.zeros((len(joints), len(points)))
    for joint, place in enumerate(joints):
        if joint < 2:
            candidates = np.concatenate(skin)
            heights = np.abs(points[candidates, 1] - place[1])
            candidates = candidates[np.argsort(heights, kind="stable")[:SUPPORT]]
        else:
            candidates = number[slice(*PARTS[("left_eyeball", "right_eyeball")[joint - 2]])]
        # the least weights that do: the solution of an underdetermined system
        system = np.concatenate([points[candidates].T, np.ones((1, len(candidates)))])
        regressor[joint, candidates] = np.linalg.lstsq(system, np.append(place, 1.0), rcond=None)[0]
    return regressor
