"""Make a copy of a dataset whose template has few expressions, to tell what a residual has to make up for.

usage: python tools/coarse_template.py --data DIR --out DIR --directions 8

The dataset is a VHAP export with a template.npz, as `python -m samira_warp.prepare` and the built-in subject
make them. Of what expressions do to the mesh in the training frames, the template of the copy keeps the
principal directions, and every frame's expression is the projection on them; all else is linked. Directions
are scaled so that their coefficients have a mean square of 1 over the training frames, as FLAME's have. What
else tells of expressions, as gt/exact_parameters.npz does, stays as it was and does not fit the copy:
tools/exact_tracking.py comes before this.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from samira_warp.data import TrackedSequence, open_sequence
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.data.vhap_parameters import read_parameter_file
from samira_warp.head import HeadTemplate
from samira_warp.head.template import save_template
from samira_warp.io.npz import read_npz
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

PARAMETERS, TEMPLATE = "flame_param", "template.npz"
"""What the copy has of its own, beside the canonical parameters."""


@dataclass(frozen=True)
class CoarseConfig:
    """Make a copy of a dataset whose template has few expressions."""

    data: Path
    """Dataset: a VHAP export with a template.npz."""
    out: Path
    """Folder to make."""
    directions: int
    """How many expressions the template is to have."""


class Directions(NamedTuple):
    """Principal directions of displacements, float64.

    Attributes:
        shapes: (V, 3, K) metres, orthogonal.
        from_expressions: (K, E) coefficients of the projection, from the template's own.
    """

    shapes: np.ndarray
    from_expressions: np.ndarray


def main(config: CoarseConfig) -> None:
    """Link what stays, write template and parameters anew, and say what is missing."""
    sequence = open_sequence(config.data)
    _check(config, sequence)
    template = sequence.template
    train, every = (expressions(sequence, which) for which in (sequence.train, range(len(sequence.frames))))
    shapes = template.shapedirs[:, :, template.n_shape :].astype(np.float64)
    found = principal(shapes, train, config.directions)
    coarse = with_expressions(template, found.shapes)
    entries = sorted(config.data.resolve().iterdir())
    (config.out / PARAMETERS).mkdir(parents=True)
    for entry in entries:
        if entry.name not in (PARAMETERS, TEMPLATE, CANONICAL_FILE):
            (config.out / entry.name).symlink_to(entry)
    save_template(coarse, config.out / TEMPLATE)
    for path in (config.data / CANONICAL_FILE, *sorted((config.data / PARAMETERS).glob("*.npz"))):
        expression = read_parameter_file(path, template).parameters.expression.numpy()
        arrays: dict[str, Any] = {**read_npz(path, wanted=lambda _: True)}
        arrays["expr"] = (found.from_expressions @ expression)[None].astype(np.float32)
        np.savez(config.out / path.relative_to(config.data), **arrays)
    lengths = 1e3 * missing(shapes, every, found)
    print(
        f"{config.directions} directions for {template.n_expression} expressions: missing "
        f"{lengths.mean():.3f} mm of motion on average over vertices and frames, "
        f"{np.percentile(lengths, 99.0):.3f} mm at the 99th percentile, {lengths.max():.3f} mm at most"
    )


def expressions(sequence: TrackedSequence, frames: Sequence[int]) -> np.ndarray:
    """(N, E) float64 expressions of some frames."""
    return sequence.batch(frames).expression.numpy().astype(np.float64)


def principal(shapes: np.ndarray, train: np.ndarray, count: int) -> Directions:
    """The directions that leave the least of the training frames' displacements, in squares.

    They are right singular vectors of the frames' displacements as they are, not less their mean: a face
    without expression stays the template's.

    Args:
        shapes: (V, 3, E) metres, the expressions.
        train: (N, E) coefficients of the training frames.
        count: K.

    Raises:
        UserError: There are not as many.
    """
    flat = shapes.reshape(-1, shapes.shape[2])
    basis, triangle = np.linalg.qr(flat)
    _, singular, rows = np.linalg.svd(train @ triangle.T, full_matrices=False)
    # coefficients are float32, each off by up to half its last place: what that alone makes is no direction
    rounding = 2.0**-24 * np.linalg.norm(train) * np.linalg.norm(triangle, 2)
    rank = int((singular > rounding).sum())
    if not 1 <= count <= rank:
        expected = f"a number from 1 to {rank}, which is how many the training frames show"
        raise UserError("--directions", expected=expected, found=count)
    scales = singular[:count] / np.sqrt(len(train))
    directions = rows[:count] * scales[:, None]
    return Directions(
        (basis @ directions.T).reshape(*shapes.shape[:2], count), rows[:count] @ triangle / scales[:, None]
    )


def with_expressions(template: HeadTemplate, shapes: np.ndarray) -> HeadTemplate:
    """The template with other expressions, (V, 3, K) metres."""
    identity = template.shapedirs[:, :, : template.n_shape]
    return replace(
        template,
        shapedirs=np.concatenate([identity, shapes.astype(np.float32)], axis=2),
        expression_names=tuple(f"direction_{number}" for number in range(shapes.shape[2])),
    )


def missing(shapes: np.ndarray, coefficients: np.ndarray, found: Directions) -> np.ndarray:
    """(N, V) metres by which a projection moves vertices less than it should, or elsewhere.

    Args:
        shapes: (V, 3, E) metres, the expressions.
        coefficients: (N, E) theirs, in some frames.
        found: What they are projected on.
    """
    left = shapes - found.shapes @ found.from_expressions
    return np.stack([np.linalg.norm(left @ frame, axis=1) for frame in coefficients])


def _check(config: CoarseConfig, sequence: TrackedSequence) -> None:
    if sequence.format != "VHAP export":
        raise UserError(config.data, expected="a VHAP export", found=sequence.format)
    if config.out.exists():
        raise UserError(config.out, expected="a new folder", found="one that exists")
    folder = (config.data / PARAMETERS).resolve()
    for frame in sequence.frames:
        if frame.parameters_path.resolve().parent != folder:
            raise UserError(frame.parameters_path, expected=f"a file in {folder}", found="one elsewhere")


if __name__ == "__main__":
    sys.exit(run(main, CoarseConfig, program="python tools/coarse_template.py"))
