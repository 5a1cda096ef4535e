"""ARKit's shapes on a head whose expressions have no names: a linear map, fitted to landmarks.

On the built-in head both are known: its expressions have ARKit's names, and it has the landmarks of the face
mesh. `assets/arkit_landmarks.npz` holds how far each shape moves these (`tools/make_arkit_landmarks.py`). On
another head with landmarks, the expressions and the turn of the jaw are sought that move its landmarks the
same way, by least squares, in the head's own size.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import samira_warp
from samira_warp.drive.arkit import NUMBER_OF, SHAPES
from samira_warp.head.template import HeadTemplate

RIDGE = 0.005
"""Of the squares of coefficients, as a share of the mean square of what one coefficient moves: what
expressions do alike is shared among them, and none is driven far for a little."""


class KnownShapes(NamedTuple):
    """Shapes on the landmarks of the built-in head.

    Attributes:
        names: A of `SHAPES`.
        rest: (478, 3) float64 metres, the landmarks on the mean head at rest.
        moved: (A, 478, 3) float64 metres by which 1 of each shape moves them.
    """

    names: tuple[str, ...]
    rest: np.ndarray
    moved: np.ndarray


class FittedShapes(NamedTuple):
    """A linear map from shapes to a head.

    Attributes:
        names: Shapes that were known, A of `SHAPES`.
        expression: (E, 52) coefficients by shape, 0 for shapes that were not known.
        jaw: (3, 52) axis-angle of the jaw, radians.
        moving: (52,) bool which shapes were known.
        left: What of the landmarks' motion the map leaves over, as a share, root mean square over all shapes.
    """

    names: tuple[str, ...]
    expression: np.ndarray
    jaw: np.ndarray
    moving: np.ndarray
    left: float


@cache
def known_shapes() -> KnownShapes:
    """The shapes that come with the package."""
    path = Path(samira_warp.__file__).parent / "assets" / "arkit_landmarks.npz"
    with np.load(path, allow_pickle=False) as archive:
        names = tuple(str(name) for name in archive["names"])
        return KnownShapes(names, archive["rest"].astype(np.float64), archive["moved"].astype(np.float64))


def fit_shapes(template: HeadTemplate) -> FittedShapes:
    """Fit a head with landmarks.

    Args:
        template: The head; without a jaw its expressions have to do.
    """
    assert template.landmarks is not None
    known, ids = known_shapes(), template.landmarks.ids
    embedding, faces = template.landmarks, template.faces
    rest = embedding.points(template.v_template.astype(np.float64), faces)
    turn, scale = _laid(known.rest[ids], rest)
    aims = scale * known.moved[:, ids] @ turn.T
    shapes = np.moveaxis(template.shapedirs[..., template.n_shape :].astype(np.float64), -1, 0)
    columns = [embedding.points(shapes, faces).reshape(len(shapes), -1)]
    jaw = template.joint_names.index("jaw") if "jaw" in template.joint_names else None
    if jaw is not None:
        columns.append(_turned(template, jaw, rest).reshape(3, -1))
    moves = np.concatenate(columns)
    aimed = aims.reshape(len(aims), -1)
    square = moves @ moves.T
    ridge = RIDGE * np.diag(np.diag(square)) + 1e-12 * np.eye(len(square)) * np.trace(square)
    found = np.linalg.solve(square + ridge, moves @ aimed.T)
    left = float(np.linalg.norm(aimed.T - moves.T @ found) / np.linalg.norm(aimed))
    numbers = [NUMBER_OF[name] for name in known.names]
    expression, turned = np.zeros((len(shapes), len(SHAPES))), np.zeros((3, len(SHAPES)))
    expression[:, numbers] = found[: len(shapes)]
    if jaw is not None:
        turned[:, numbers] = found[len(shapes) :]
    return FittedShapes(known.names, expression, turned, np.isin(np.arange(len(SHAPES)), numbers), left)


def _laid(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Turn (3, 3) and scale that take (L, 3) points onto others, as well as they can (Umeyama 1991)."""
    source, target = source - source.mean(axis=0), target - target.mean(axis=0)
    left, values, right = np.linalg.svd(target.T @ source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return (left * signs) @ right, float((values * signs).sum() / (source**2).sum())


def _turned(template: HeadTemplate, jaw: int, rest: np.ndarray) -> np.ndarray:
    """(3, L, 3) how the landmarks move with the jaw's turn about x, y and z, at rest."""
    assert template.landmarks is not None
    place = template.joint_regressor[jaw].astype(np.float64) @ template.v_template
    weights = template.landmarks.points(template.weights[:, jaw : jaw + 1].astype(np.float64), template.faces)
    return np.stack([weights * np.cross(axis, rest - place) for axis in np.eye(3)])
