"""Pose and expression refined by an avatar's own renderer: what it draws is moved onto the pictures."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from samira_warp.avatar import Avatar
from samira_warp.avatar.occlusion import Occlusion
from samira_warp.data import Frame, load_pixels, open_sequence
from samira_warp.data.vhap import CANONICAL_FILE
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.light import FilteredLight
from samira_warp.prepare.export import parameter_arrays
from samira_warp.support.errors import UserError

RESOLUTION = 192
"""Pixels of the longer side of what is compared."""

STEPS, STEPS_ON = 24, 8
"""For the first frame, and for those that begin where the one before has ended."""

SCALE_ON, LAST = 0.4, 0.03
"""Of the rates below: where later frames begin, and where all end."""

RATES = {"translation": 1.5e-3, "rotations": 3e-3, "expression": 2e-2}
"""Adam's at the first step: metres, radians, coefficients. The first frame goes at most ten times as far,
15 mm, 1.7 degrees, 0.2, and each that follows twice as far beyond that. The tracker errs most along the view:
two parts in a hundred of the head's distance over a film of `ict_a`."""

HOLD = {"translation": 0.006, "rotations": 0.01, "expression": 0.1}
"""How far the tracker is off, one standard deviation."""

HOLD_WEIGHT = 2e-4
"""Of the squares of that, beside the mean absolute difference of display values."""


Correction: TypeAlias = dict[str, Tensor]
"""What is added to a frame's parameters, by their name."""


class Refined(NamedTuple):
    """One frame.

    Attributes:
        parameters: After it.
        correction: What was added to the tracker's.
        before: Mean absolute difference of display values that it began with.
        after: The one that it ended with.
    """

    parameters: FrameParameters
    correction: Correction
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
    changes, painter = [], Painter.of(avatar)
    correction: Correction | None = None
    for frame in tqdm(sequence.frames, desc="refining", unit="frame", dynamic_ncols=True):
        found = refine_frame(painter, frame, before=correction)
        correction = found.correction
        path = target / frame.parameters_path.relative_to(dataset)
        np.savez(path, **parameter_arrays(sequence.template, found.parameters), shape=shape)
        changes.append((found.before, found.after))
    before, after = np.median(np.array(changes), axis=0)
    say(f"refined by the avatar: from {255 * before:.2f} to {255 * after:.2f} of 255 display values apart")


class Painter(NamedTuple):
    """An avatar under its learned light, both held.

    Attributes:
        avatar: The avatar.
        light: Its light, filtered once.
    """

    avatar: Avatar
    light: FilteredLight

    @classmethod
    def of(cls, avatar: Avatar) -> Painter:
        """Hold an avatar: its parameters get no gradients from then on."""
        with torch.no_grad():
            return cls(avatar.requires_grad_(requires_grad=False), avatar.light())

    def occlusion(self, parameters: FrameParameters) -> Occlusion | None:
        """What the head blocks in a frame, for all steps; None where it learned its light without shadows."""
        if not self.avatar.settings.visibility:
            return None
        return self.avatar.occluder.occlude(self.avatar.canonical.pose(parameters))

    def paint(self, parameters: FrameParameters, camera: Camera, occlusion: Occlusion | None) -> Tensor:
        """(H, W, 3) display values on white."""
        motion, arrival = self.avatar.move(parameters), None
        if occlusion is not None:
            arrival = self.avatar.arrival(occlusion.under(motion.head), self.light, camera)
        gbuffer = self.avatar.rasterize(motion, camera, arrival=arrival)
        return self.avatar.shade(motion, gbuffer, camera, self.light).image


class Fitted(NamedTuple):
    """A frame as an avatar is moved onto it.

    Attributes:
        painter: The avatar.
        camera: The frame's, at the size that is compared.
        image: (H, W, 3) its picture.
        start: The tracker's parameters.
        occlusion: What the head blocks there.
    """

    painter: Painter
    camera: Camera
    image: Tensor
    start: FrameParameters
    occlusion: Occlusion | None

    @classmethod
    def of(cls, painter: Painter, frame: Frame) -> Fitted:
        """Read a frame's picture."""
        device = painter.light.irradiance.device
        camera = frame.camera.with_longer_side(RESOLUTION).to(device)
        image = load_pixels(frame, width=camera.width, height=camera.height).image.to(device)
        start = frame.parameters.to(device)
        return cls(painter, camera, image, start, painter.occlusion(start))

    def moved(self, correction: Correction) -> FrameParameters:
        """The tracker's parameters with a correction added."""
        return replace(
            self.start, **{name: getattr(self.start, name) + values for name, values in correction.items()}
        )

    def error(self, correction: Correction) -> Tensor:
        """Mean absolute difference of display values."""
        painted = self.painter.paint(self.moved(correction), self.camera, self.occlusion)
        return (painted - self.image).abs().mean()


def refine_frame(painter: Painter, frame: Frame, *, before: Correction | None = None) -> Refined:
    """Move what an avatar draws onto a frame's picture, by Adam.

    Args:
        painter: The avatar.
        frame: The frame.
        before: The correction of the frame before, whose error is mostly this one's, too: fewer steps remain.
    """
    fitted = Fitted.of(painter, frame)
    none = {name: torch.zeros_like(getattr(fitted.start, name)) for name in RATES}
    with torch.no_grad():
        errors = [(float(fitted.error(begin)), begin) for begin in (none, before) if begin is not None]
    best = min(errors, key=lambda pair: pair[0])
    moved = {name: values.clone().requires_grad_() for name, values in best[1].items()}
    steps, scale = (STEPS, 1.0) if before is None else (STEPS_ON, SCALE_ON)
    optimizer = torch.optim.Adam(
        [{"params": [values], "lr": scale * RATES[name]} for name, values in moved.items()], betas=(0.8, 0.95)
    )
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, (LAST / scale) ** (1 / steps))
    for step in range(steps + 1):
        difference = fitted.error(moved)
        if float(difference.detach()) < best[0]:
            best = float(difference.detach()), {name: each.detach().clone() for name, each in moved.items()}
        if step == steps:
            break
        held = torch.stack([(values / HOLD[name]).square().sum() for name, values in moved.items()]).sum()
        optimizer.zero_grad(set_to_none=True)
        gradients = torch.autograd.grad(difference + HOLD_WEIGHT * held, list(moved.values()))
        for values, gradient in zip(moved.values(), gradients, strict=True):
            values.grad = gradient
        optimizer.step()
        decay.step()
    return Refined(fitted.moved(best[1]).to("cpu"), best[1], errors[0][0], best[0])
