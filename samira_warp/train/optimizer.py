"""Adam over named parameter groups, each with its scheduled rate."""

from __future__ import annotations

import math

import torch
from torch import nn

from samira_warp.avatar import Avatar
from samira_warp.avatar.gaussians import Gaussians
from samira_warp.train.row_adam import RowAdam
from samira_warp.train.schedule import learning_rate
from samira_warp.train.tracking import TrackedParameters

ADAM_EPSILON = 1e-15
"""Far below any gradient here, as 3DGS has it: the default 1e-8 would damp the small gradients of single
Gaussians."""

DECAY = (0.9, 0.999)
"""Of the first and second moments from one frame to the next: Adam's own."""


def make_optimizer(avatar: Avatar, tracked: TrackedParameters) -> RowAdam:
    """One group a rate, named as in `schedule.RATES`.

    Gaussians' groups hold one parameter each; those of tracking hold tables with a row a frame.
    """
    groups: dict[str, list[nn.Parameter]] = {
        name: [getattr(avatar.gaussians, name)] for name in Gaussians.PARAMETERS
    }
    groups["response"] = [avatar.response_logits]
    groups["network"] = list(avatar.motion.parameters())
    groups["light"] = list(avatar.light.parameters())
    tables = {
        "expression": [tracked.expression],
        "pose": [tracked.rotations],
        "translation": [tracked.translation],
    }
    return RowAdam(
        [{"params": parameters, "name": name} for name, parameters in groups.items()]
        + [{"params": parameters, "name": name, "rows": True} for name, parameters in tables.items()],
        lr=0.0,
        betas=DECAY,
        eps=ADAM_EPSILON,
        fused=True,
    )


def set_rates(
    optimizer: torch.optim.Adam, *, step: int, steps: int, frames: int = 1, light_frames: int = 1
) -> None:
    """Give every group its rate and decay at ``step`` of ``steps``, for the mean of some frames' gradients.

    Those of the light are of ``light_frames`` (`train.shared_light`).

    A frame's row learns from that frame alone, once, as it would by itself. What all frames share takes one
    step for ``frames`` of them: root ``frames`` times as far, and the moments decay as they would in as many
    steps, so that they reach as far back in frames. That is the square-root rule for Adam (Malladi et al., On
    the SDEs and scaling rules for adaptive gradient algorithms, 2022), with the decay's powers as Zhao et al.
    have them (On scaling up 3D Gaussian splatting training, 2024).
    """
    for group in optimizer.param_groups:
        alone = group.get("rows", False)
        group["lr"] = learning_rate(group["name"], step=step, steps=steps)
        if not alone:
            together = light_frames if group["name"] == "light" else frames
            group["lr"] *= math.sqrt(together)
            group["betas"] = tuple(decay**together for decay in DECAY)


def reset_moments(optimizer: torch.optim.Adam, group_name: str) -> None:
    """Forget the moments of one group: its values were changed by something other than their gradients."""
    for group in optimizer.param_groups:
        if group["name"] == group_name:
            for parameter in group["params"]:
                for moment in ("exp_avg", "exp_avg_sq"):
                    if moment in optimizer.state[parameter]:
                        optimizer.state[parameter][moment].zero_()


def forget_gaussians(optimizer: torch.optim.Adam, which: torch.Tensor) -> None:
    """Forget the moments of some Gaussians (N,) bool, so that where they rest they rest."""
    for group in optimizer.param_groups:
        if group["name"] in Gaussians.PARAMETERS:
            for moment in ("exp_avg", "exp_avg_sq"):
                (parameter,) = group["params"]
                if moment in optimizer.state[parameter]:
                    optimizer.state[parameter][moment][which] = 0.0


def replace_gaussians(
    optimizer: torch.optim.Adam, old: Gaussians, new: Gaussians, kept: torch.Tensor
) -> None:
    """Put new Gaussians in the optimiser.

    Those that stay keep their moments, those that are new have moments of zero.

    Args:
        optimizer: The optimiser that holds ``old``.
        old: The Gaussians before density control.
        new: The Gaussians after it: first those at ``kept``, then new ones.
        kept: (M,) indices into ``old``.
    """
    for group in optimizer.param_groups:
        if group["name"] not in Gaussians.PARAMETERS:
            continue
        before, after = getattr(old, group["name"]), getattr(new, group["name"])
        group["params"] = [after]
        state = optimizer.state.pop(before, None)
        if state is None:
            continue
        for moment in ("exp_avg", "exp_avg_sq"):
            grown = torch.zeros_like(after)
            grown[: len(kept)] = state[moment][kept]
            state[moment] = grown
        optimizer.state[after] = state
