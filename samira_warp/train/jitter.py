"""Noise of the tracker, as its own trajectory shows it, for the motion network to see in training.

A network that sees every frame as it was tracked learns the errors of each by heart. Beside others that the
tracker might have given as well, it can learn only what lasts over them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from samira_warp.head import FrameParameters

NORMAL_MEDIAN = 0.6745
"""Median size of a normal variable, in standard deviations."""

TRACKED = ("translation", "rotations", "expression")
"""What a tracker gives of every frame."""


def tracking_noise(tracked: FrameParameters, timesteps: Sequence[int]) -> dict[str, Tensor]:
    """Standard deviations of each parameter's noise from frame to frame, by name.

    Second differences of a smooth motion are next to nothing, those of white noise have six times its
    variance. Their median takes no notice of the moments in which a face moves fast.

    Args:
        tracked: A batch of T frames.
        timesteps: Of each; three in a row make a second difference.

    Returns:
        Of each of TRACKED, without the batch's dimension; 0 where no three frames follow one another.
    """
    moments = np.asarray(timesteps)
    order = np.argsort(moments, kind="stable")
    steps = np.diff(moments[order])
    inner = np.flatnonzero((steps[:-1] == 1) & (steps[1:] == 1)) + 1
    noise = {}
    for name in TRACKED:
        values = getattr(tracked, name)[torch.from_numpy(order).to(tracked.translation.device)]
        if not len(inner):
            noise[name] = torch.zeros_like(values[0])
            continue
        bends = values[inner + 1] - 2.0 * values[inner] + values[inner - 1]
        noise[name] = bends.abs().median(dim=0).values / (NORMAL_MEDIAN * 6.0**0.5)
    return noise


def jittered(
    parameters: FrameParameters, noise: dict[str, Tensor], *, generator: torch.Generator
) -> FrameParameters:
    """A frame as its tracker might have given it as well.

    Args:
        parameters: One frame.
        noise: `tracking_noise`.
        generator: On the CPU; decides what is drawn.
    """
    changed = {}
    for name, deviation in noise.items():
        drawn = torch.randn(deviation.shape, generator=generator).to(deviation)
        changed[name] = getattr(parameters, name) + deviation * drawn
    return replace(parameters, **changed)
