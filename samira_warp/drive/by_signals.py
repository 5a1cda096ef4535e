"""From a face as phones send it to what an avatar takes over: shapes by name, angles to joints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.drive.arkit import NUMBER_OF, SHAPES, FaceSignal, half_of, known_shape
from samira_warp.drive.fitted_shapes import fit_shapes
from samira_warp.drive.stance import Face
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError

JAW_OPEN = 25.0
"""Degrees of a jaw that is all open, where no shape opens it: ICT-FaceKit's jawOpen moves the chin by 42 mm,
95 from the joint."""

LOOKS = tuple(name for name in SHAPES if name.startswith("eyeLook"))
"""Shapes that tell nothing which the eyes' own joints do not."""


@dataclass(frozen=True, eq=False)
class ShapeMap:
    """Which of ARKit's shapes move what of a head.

    Attributes:
        expression: (E, 52) coefficients by shape.
        jaw: (3, 52) axis-angle of the jaw, radians, by shape.
        missing: Shapes that move nothing.
        said: What the map is, in words.
    """

    expression: np.ndarray
    jaw: np.ndarray
    missing: tuple[str, ...]
    said: str


def map_shapes(template: HeadTemplate) -> ShapeMap:
    """How ARKit's shapes move a head: by the names of its expressions, or by a fit to its landmarks.

    A shape of both sides, such as cheekPuff, moves both halves of a head that parts it.

    Raises:
        UserError: Its expressions have numbers for names, and it has no landmarks to fit by.
    """
    named = {name: known_shape(name) or half_of(name) for name in template.expression_names}
    if not any(named.values()):
        return _fitted(template)
    expression = np.zeros((template.n_expression, len(SHAPES)))
    for row, name in enumerate(template.expression_names):
        shape = named[name]
        if shape is not None:
            expression[row, NUMBER_OF[shape]] = 1.0
    jaw = np.zeros((3, len(SHAPES)))
    opened = NUMBER_OF["jawOpen"]
    if not expression[:, opened].any() and "jaw" in template.joint_names:
        jaw[0, opened] = np.radians(JAW_OPEN)
    moving: np.ndarray = np.asarray(np.concatenate([expression, jaw]).any(axis=0))
    count = int(moving.sum())
    return ShapeMap(expression, jaw, _missing(template, moving), f"{count} of ARKit's 52 shapes by name")


def _fitted(template: HeadTemplate) -> ShapeMap:
    if template.landmarks is None:
        expected = "a head whose expressions have names of ARKit's, or landmarks (docs/heads.md)"
        raise UserError(
            "--drive", expected=expected, found="one with numbers for names, and without landmarks"
        )
    found = fit_shapes(template)
    said = (
        f"{len(found.names)} of ARKit's 52 shapes by a linear map to its {template.n_expression} expressions "
        f"and its jaw, fitted to landmarks: {found.left:.0%} of their motion is left over, root mean square"
    )
    return ShapeMap(found.expression, found.jaw, _missing(template, found.moving), said)


def _missing(template: HeadTemplate, moving: np.ndarray) -> tuple[str, ...]:
    eyes = {"left_eye", "right_eye"} <= set(template.joint_names)
    return tuple(
        name for name, moves in zip(SHAPES, moving, strict=True) if not moves and not (eyes and name in LOOKS)
    )


class SignalDriver:
    """Takes signals over as they are, or relative to a neutral one."""

    def __init__(self, avatar: HeadTemplate, *, gain: float = 1.0) -> None:
        """Match an avatar's head.

        Args:
            avatar: The head.
            gain: Factor on the expression.

        Raises:
            UserError: As `map_shapes`.
        """
        self.map = map_shapes(avatar)
        self._avatar, self._gain = avatar, gain
        self._neutral: FaceSignal | None = None

    def take_for_neutral(self, neutral: FaceSignal | None) -> None:
        """Take a signal for the neutral one from now on; None for the one of zeros."""
        self._neutral = neutral

    def face(self, signal: FaceSignal) -> Face:
        """What is taken over of a frame."""
        signal = signal if self._neutral is None else relative(signal, self._neutral)
        shapes = signal.shapes.clip(0.0, 1.0)
        rotations = torch.zeros(len(self._avatar.joint_names), 3, dtype=torch.float64)
        joints = {name: joint for joint, name in enumerate(self._avatar.joint_names)}
        for name, turn in zip(("left_eye", "right_eye"), signal.gaze, strict=True):
            if name in joints:
                rotations[joints[name]] = torch.from_numpy(turn)
        if "jaw" in joints:
            rotations[joints["jaw"]] = torch.from_numpy(self.map.jaw @ shapes)
        expression: Tensor = torch.from_numpy(self._gain * (self.map.expression @ shapes))
        if self._avatar.names_expressions:
            expression = expression.clamp(0.0, 1.0)
        head = np.zeros(3) if signal.head is None else signal.head
        turn = torch.from_numpy(Rotation.from_rotvec(head).as_matrix())
        return Face(turn, torch.zeros(3, dtype=torch.float64), rotations, expression)


def relative(signal: FaceSignal, neutral: FaceSignal) -> FaceSignal:
    """A signal less a neutral one: shapes and gaze by subtraction, the head in the neutral one's axes."""
    head = signal.head
    if head is not None and neutral.head is not None:
        head = (Rotation.from_rotvec(neutral.head).inv() * Rotation.from_rotvec(head)).as_rotvec()
    eyes = signal.gaze - neutral.gaze
    return replace(signal, shapes=signal.shapes - neutral.shapes, head=head, eyes=eyes)
