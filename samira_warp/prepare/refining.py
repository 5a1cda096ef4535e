"""Pose and expression refined by an avatar's own renderer: what it draws is moved onto the pictures."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from samira_warp.avatar import Avatar
from samira_warp.data import Frame, TrackedSequence, load_pixels, open_sequence
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.head import FrameParameters
from samira_warp.prepare.export import parameter_arrays
from samira_warp.support.errors import UserError

RESOLUTION = 192
"""Pixels of the longer side of what is compared."""

STEPS = 16
"""For each frame; the loss has settled by then."""

RATES = {"translation": 6e-4, "rotations": 3e-3, "expression": 2e-2}
"""Adam's at the first step: metres, radians, coefficients. They fall to a tenth, so that a frame goes at most
seven times as far: 4 mm, 1.2 degrees, 0.14."""

HOLD = {"translation": 0.002, "rotations": 0.01, "expression": 0.1}
"""How far the tracker is off, one standard deviation."""

HOLD_WEIGHT = 2e-4
"""Of the squares of that, beside the mean absolute difference of display values."""


class Refined(NamedTuple):
    """One frame.

    Attributes:
        parameters: After it.
        before: Mean absolute difference of display values that it began with.
        after: The one that it ended with.
    """

    parameters: FrameParameters
    before: float
    after: float


def refine_dataset(avatar: Avatar, dataset: Path, target: Path, *, say: Callable[[str], None]) -> None:
    """Write a copy of a dataset whose frames' parameters are refined by an avatar.

    The copy has the avatar's identity, which its parameters belong to.

    Args:
        avatar: Of the same person, with the same head model.
        dataset: The folder, as `samira_warp.prepare.export` writes it.
        target: Where to; it exists, and is empty.
        say: Told what came of it.

    Raises:
        UserError: The avatar has another head model, or a picture cannot be read.
        OSError: A file cannot be written.
    """
    sequence = open_sequence(dataset, split="0.5")
    if avatar.canonical.template.hash != sequence.template.hash:
        raise UserError(
            "--refine", expected="an avatar with the head model of the tracking", found="one with another"
        )
    shutil.copytree(dataset, target, dirs_exist_ok=True)
    canonical = avatar.canonical
    rest = parameter_arrays(sequence.template, canonical.rig.rest().to("cpu"))
    shape = canonical.shape.cpu().numpy()
    subject: dict[str, Any] = {"shape": shape}
    if canonical.static_offset is not None:
        subject["static_offset"] = canonical.static_offset.cpu().numpy()[None]
    np.savez(target / CANONICAL_FILE, **rest, **subject)
    changes = []
    for frame in tqdm(sequence.frames, desc="refining", unit="frame", dynamic_ncols=True):
        found = refine_frame(avatar, sequence, frame)
        path = target / frame.parameters_path.relative_to(dataset)
        np.savez(path, **parameter_arrays(sequence.template, found.parameters), shape=shape)
        changes.append((found.before, found.after))
    before, after = np.median(np.array(changes), axis=0)
    say(f"refined by the avatar: from {255 * before:.2f} to {255 * after:.2f} of 255 display values apart")


def refine_frame(avatar: Avatar, sequence: TrackedSequence, frame: Frame) -> Refined:
    """Move what an avatar draws onto a frame's picture, by Adam."""
    camera = frame.camera.with_longer_side(RESOLUTION)
    image = load_pixels(frame, width=camera.width, height=camera.height).image
    device = avatar.canonical.vertices.device
    image = image.to(device)
    start = frame.parameters.to(device)
    moved = {name: torch.zeros_like(getattr(start, name), requires_grad=True) for name in RATES}
    optimizer = torch.optim.Adam(
        [{"params": [values], "lr": RATES[name]} for name, values in moved.items()], betas=(0.8, 0.95)
    )
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1 / STEPS))
    before = after = float("inf")
    best: dict[str, Tensor] = {name: values.detach().clone() for name, values in moved.items()}
    for step in range(STEPS + 1):
        parameters = FrameParameters(
            **{name: getattr(start, name) + values for name, values in moved.items()},
            dynamic_offset=start.dynamic_offset,
        )
        difference = (avatar.render(parameters, camera).image - image).abs().mean()
        if step == 0:
            before = after = float(difference.detach())
        elif float(difference.detach()) < after:
            after = float(difference.detach())
            best = {name: values.detach().clone() for name, values in moved.items()}
        if step == STEPS:
            break
        held = torch.stack([(values / HOLD[name]).square().sum() for name, values in moved.items()]).sum()
        optimizer.zero_grad(set_to_none=True)
        gradients = torch.autograd.grad(difference + HOLD_WEIGHT * held, list(moved.values()))
        for values, gradient in zip(moved.values(), gradients, strict=True):
            values.grad = gradient
        optimizer.step()
        decay.step()
    found = FrameParameters(
        **{name: (getattr(start, name) + best[name]).cpu() for name in RATES},
        dynamic_offset=None if start.dynamic_offset is None else start.dynamic_offset.cpu(),
    )
    return Refined(found, before, after)
