"""What ties the residual to conditions is let go of again, unless it is needed at frame after frame.

A frame has some sixty conditions, a film a few hundred frames: many mixtures of conditions tell training
frames apart, and Adam moves all of them as far as the few that cause the motion. Weights that decay keep what
all frames ask for (docs/measurements.md).
"""

from __future__ import annotations

import torch
from torch import nn

from samira_warp.nets import MotionNetwork

CONDITION_DECAY = 4.0
"""Share of a weight that goes with a step, in units of the network's rate: at 2e-3, one in 125."""


@torch.no_grad()
def decay_conditions(motion: MotionNetwork, *, rate: float, frames: int = 1) -> None:
    """Shrink the maps from conditions to the features' scales and shifts.

    Args:
        motion: Changed in place, its biases and all else left.
        rate: The network's learning rate for one frame.
        frames: Frames that were learned from.
    """
    for layer in motion.adain.modules():
        if isinstance(layer, nn.Linear):
            layer.weight.mul_((1.0 - CONDITION_DECAY * rate) ** frames)
