"""The training frames' head parameters, fine-tuned with the avatar."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import nn

from samira_warp.avatar.frames import FIELDS
from samira_warp.head import FrameParameters


class TrackedParameters(nn.Module):
    """One learnable row a training frame and field, (T, ...), starting from the tracker's values; shape and
    offsets stay.
    """

    def __init__(self, frames: list[FrameParameters]) -> None:
        super().__init__()
        for name in FIELDS:
            self.register_parameter(
                name, nn.Parameter(torch.stack([getattr(frame, name) for frame in frames]))
            )

    def frame(self, row: int, tracked: FrameParameters) -> FrameParameters:
        """The fine-tuned parameters of training frame ``row``, with the offsets of ``tracked``."""
        return replace(tracked, **{name: getattr(self, name)[row] for name in FIELDS})
