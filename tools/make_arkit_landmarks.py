"""Make `samira_warp/assets/arkit_landmarks.npz`: how ARKit's shapes move landmarks, by the built-in head.

python tools/make_arkit_landmarks.py --out samira_warp/assets/arkit_landmarks.npz
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from samira_subject.head import build_template
from samira_warp.drive.arkit import SHAPES, known_shape
from samira_warp.drive.by_signals import JAW_OPEN
from samira_warp.head import FrameParameters, HeadTemplate, Rig
from samira_warp.support.cli import run


@dataclass(frozen=True)
class ShapeOptions:
    """Pose the built-in head with each of ARKit's shapes that it has, and write where its landmarks go."""

    out: Path
    """The file."""


def posed(template: HeadTemplate, *, expression: int | None = None, jaw: float = 0.0) -> np.ndarray:
    """(478, 3) float64 landmarks of the mean head with one expression, or with its jaw open."""
    parameters = FrameParameters(
        torch.zeros(3), torch.zeros(len(template.joint_names), 3), torch.zeros(template.n_expression)
    )
    if expression is not None:
        parameters.expression[expression] = 1.0
    parameters.rotations[template.joint_names.index("jaw"), 0] = jaw
    head = Rig.build(template).pose(parameters, torch.zeros(template.n_shape))
    assert template.landmarks is not None
    points = template.landmarks.points(head.vertices.double().numpy(), template.faces)
    places = np.zeros((int(template.landmarks.ids.max()) + 1, 3))
    places[template.landmarks.ids] = points
    return places


def main(options: ShapeOptions) -> None:
    """Write the file: names, landmarks at rest (metres), and by how much 1 of each shape moves them."""
    template = build_template()
    rest = posed(template)
    numbers = {known_shape(name): number for number, name in enumerate(template.expression_names)}
    moved = {name: posed(template, expression=numbers[name]) - rest for name in SHAPES if name in numbers}
    # a map is linear: a quarter of the turn, four times
    opened = posed(template, jaw=np.radians(JAW_OPEN) / 4.0) - rest
    moved = {"jawOpen": 4.0 * opened, **moved}
    halves = {"cheekPuff": ("cheekPuff_L", "cheekPuff_R")}
    for name, parts in halves.items():
        if name not in moved:
            found = [template.expression_names.index(part) for part in parts]
            moved[name] = sum(posed(template, expression=number) - rest for number in found)
    np.savez_compressed(
        options.out,
        names=np.array(sorted(moved, key=SHAPES.index)),
        rest=rest.astype(np.float32),
        moved=np.stack([moved[name] for name in sorted(moved, key=SHAPES.index)]).astype(np.float16),
    )


if __name__ == "__main__":
    raise SystemExit(run(main, ShapeOptions, program="python tools/make_arkit_landmarks.py"))
