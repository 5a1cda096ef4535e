"""What moves a head, in one frame or in many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class FrameParameters:
    """What moves a head: axis-angle rotations in radians, lengths in metres.

    One frame, or a batch of them: all tensors have the same leading dimensions, none for one frame. A batch
    is indexed along the first of them, and its rows are views.

    Attributes:
        translation: (..., 3) of the whole head, after all rotations.
        rotations: (..., J, 3) of each joint about its own location, in the order of the template's joints.
        expression: (..., E) coefficients of the expression shapes.
        dynamic_offset: (..., V, 3) the frames' own offsets from the linear shapes, or None for zero.
    """

    translation: Tensor
    rotations: Tensor
    expression: Tensor
    dynamic_offset: Tensor | None = None

    @classmethod
    def stack(cls, frames: Sequence[FrameParameters]) -> FrameParameters:
        """A batch of frames of equal shapes, at least one.

        Frames without an offset get zeros where others have one.
        """
        offsets = [frame.dynamic_offset for frame in frames]
        known = next((offset for offset in offsets if offset is not None), None)
        return cls(
            translation=torch.stack([frame.translation for frame in frames]),
            rotations=torch.stack([frame.rotations for frame in frames]),
            expression=torch.stack([frame.expression for frame in frames]),
            dynamic_offset=None
            if known is None
            else torch.stack([torch.zeros_like(known) if offset is None else offset for offset in offsets]),
        )

    @property
    def rotation(self) -> Tensor:
        """(..., 3) of the root joint, which turns the whole head."""
        return self.rotations[..., 0, :]

    @property
    def batch_shape(self) -> torch.Size:
        """The leading dimensions; empty for one frame."""
        return self.translation.shape[:-1]

    def __len__(self) -> int:
        """How many rows a batch has along its first dimension."""
        if not self.batch_shape:
            raise TypeError("one frame has no rows")
        return self.batch_shape[0]

    def __getitem__(self, rows: int | slice | Tensor) -> FrameParameters:
        """One row of a batch along its first dimension, or some of them."""
        if not self.batch_shape:
            raise TypeError("one frame has no rows")
        offset = self.dynamic_offset
        return FrameParameters(
            translation=self.translation[rows],
            rotations=self.rotations[rows],
            expression=self.expression[rows],
            dynamic_offset=None if offset is None else offset[rows],
        )

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> FrameParameters:
        """The same parameters on another device, in another precision, or both."""

        def moved(value: Tensor) -> Tensor:
            return value.to(device=device, dtype=dtype)

        return replace(
            self,
            translation=moved(self.translation),
            rotations=moved(self.rotations),
            expression=moved(self.expression),
            dynamic_offset=None if self.dynamic_offset is None else moved(self.dynamic_offset),
        )
