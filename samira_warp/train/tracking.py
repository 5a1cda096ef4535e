"""The training frames' head parameters, fine-tuned with the avatar."""

from __future__ import annotations

from torch import nn

from samira_warp.head import FrameParameters


class TrackedParameters(nn.Module):
    """One learnable row a training frame, starting from the tracker's values; offsets stay.

    Attributes:
        translation: (T, 3) metres.
        rotations: (T, J, 3) axis-angle radians.
        expression: (T, E).
    """

    def __init__(self, tracked: FrameParameters) -> None:
        """Copy a batch of T frames."""
        super().__init__()
        self.translation = nn.Parameter(tracked.translation.clone())
        self.rotations = nn.Parameter(tracked.rotations.clone())
        self.expression = nn.Parameter(tracked.expression.clone())

    def frame(self, row: int, tracked: FrameParameters) -> FrameParameters:
        """The fine-tuned parameters of training frame ``row``, with the dynamic offset of ``tracked``."""
        offset = tracked.dynamic_offset
        return FrameParameters(
            translation=self.translation[row],
            rotations=self.rotations[row],
            expression=self.expression[row],
            dynamic_offset=None if offset is None else offset.to(self.translation.device),
        )
