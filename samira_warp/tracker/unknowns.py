"""What a fit solves for, as two tables of numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from samira_warp.head.parameters import FrameParameters


@dataclass(frozen=True)
class Layout:
    """Where a frame's and the subject's parameters lie in their rows.

    Attributes:
        joints: J, how many joints the head has.
        moving: Joints that turn.
        expressions: E.
        identities: S.
        functions: K, basis functions of the subject's offset.
    """

    joints: int
    moving: tuple[int, ...]
    expressions: int
    identities: int
    functions: int

    @property
    def frame_size(self) -> int:
        """P: translation, turns of the moving joints, expression."""
        return 3 + 3 * len(self.moving) + self.expressions

    @property
    def subject_size(self) -> int:
        """Q: identity, offset, and the logarithm of the focal length."""
        return self.identities + 3 * self.functions + 1

    @property
    def translation(self) -> slice:
        """Columns of a frame's translation."""
        return slice(0, 3)

    def turn(self, joint: int) -> slice:
        """Columns of a moving joint's axis-angle."""
        first = 3 + 3 * self.moving.index(joint)
        return slice(first, first + 3)

    @property
    def expression(self) -> slice:
        """Columns of a frame's expression."""
        return slice(self.frame_size - self.expressions, self.frame_size)

    @property
    def identity(self) -> slice:
        """Places of the subject's identity."""
        return slice(0, self.identities)

    @property
    def offset(self) -> slice:
        """Places of the subject's offset."""
        return slice(self.identities, self.subject_size - 1)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """One state of a fit, in float64: steps become smaller than float32 tells.

    Attributes:
        layout: What is where.
        frames: (N, P) a frame's parameters each.
        subject: (Q,) the subject's.
    """

    layout: Layout
    frames: Tensor
    subject: Tensor

    @classmethod
    def at_rest(cls, layout: Layout, *, frames: int, focal: float) -> Unknowns:
        """A mean head of no expression at the origin, in so many frames."""
        subject = torch.zeros(layout.subject_size, dtype=torch.float64)
        subject[-1] = torch.tensor(focal, dtype=torch.float64).log()
        return cls(layout, torch.zeros(frames, layout.frame_size, dtype=torch.float64), subject)

    @property
    def focal(self) -> float:
        """Focal length, pixels."""
        return float(self.subject[-1].exp())

    @property
    def shape(self) -> Tensor:
        """(S,) identity."""
        return self.subject[self.layout.identity]

    @property
    def offset(self) -> Tensor:
        """(K, 3) coefficients of the offset's basis functions, metres."""
        return self.subject[self.layout.offset].view(-1, 3)

    def parameters(self, rows: slice | Tensor = slice(None)) -> FrameParameters:
        """Some frames as the rig takes them, float64."""
        values = self.frames[rows]
        rotations = values.new_zeros(len(values), self.layout.joints, 3)
        for joint in self.layout.moving:
            rotations[:, joint] = values[:, self.layout.turn(joint)]
        return FrameParameters(
            values[:, self.layout.translation], rotations, values[:, self.layout.expression]
        )

    def chosen(self, rows: Tensor) -> Unknowns:
        """Some of the frames."""
        return replace(self, frames=self.frames[rows])

    def moved(self, frames: Tensor, subject: Tensor) -> Unknowns:
        """The state after a step."""
        return replace(self, frames=self.frames + frames, subject=self.subject + subject)
