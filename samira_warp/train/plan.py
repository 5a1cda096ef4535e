"""A training run as it is decided, with all that the dataset decides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from samira_warp.data import TrackedSequence
from samira_warp.data.pixels import unmatted_albedos
from samira_warp.kernels.image.structural_similarity import WINDOW
from samira_warp.support.errors import UserError
from samira_warp.train.begun import Begun
from samira_warp.train.config import TrainConfig
from samira_warp.train.schedule import Schedule
from samira_warp.train.settings import LENGTH, Settings, option


@dataclass(frozen=True)
class TrainPlan:
    """A run on its dataset, with nothing left to decide.

    Attributes:
        settings: Every option.
        sizes: Widths and heights of the training images, pixels: one for each shape of camera, the first
            frame's first.
        schedule: What happens when; its ``steps`` is the length of the run.
        skin_prior: Whether skin is held to what was measured of skin: where no albedo is compared with.
    """

    settings: Settings
    sizes: tuple[tuple[int, int], ...]
    schedule: Schedule
    skin_prior: bool


def make_plan(
    settings: Settings, sequence: TrackedSequence, config: TrainConfig, *, begun: Begun | None = None
) -> TrainPlan:
    """Decide what the dataset decides.

    Args:
        settings: Every option.
        sequence: The dataset.
        config: The options as asked, for a run that goes on is extended by what is asked for alone.
        begun: How the run that goes on was begun, None for a new one.

    Raises:
        UserError: A run that goes on from a checkpoint is asked to be shorter.
    """
    frames = len(sequence.train)
    if begun is None or begun.checkpoint is None:
        schedule = Schedule(settings.steps(frames))
    else:
        schedule = _extended(begun, config, frames=frames, out=settings.out)
    # image values that are shaded as they are cannot be held to measurements of linear reflectance
    skin_prior = settings.color_space == "srgb" and not has_pseudo_albedo(sequence)
    return TrainPlan(settings, image_sizes(sequence, settings.resolution), schedule, skin_prior)


def has_pseudo_albedo(sequence: TrackedSequence) -> bool:
    """Whether any training frame has an albedo file that can be compared with."""
    having = [frame for frame in (sequence.frames[index] for index in sequence.train) if frame.albedo_path]
    return len(unmatted_albedos(having)) < len(having)


def image_sizes(sequence: TrackedSequence, resolution: int) -> tuple[tuple[int, int], ...]:
    """Widths and heights of the training images, each once: the longer side is ``resolution``."""
    cameras = (frame.camera.with_longer_side(resolution) for frame in sequence.frames)
    return tuple(dict.fromkeys((camera.width, camera.height) for camera in cameras))


def check_size(size: tuple[int, int], *, resolution: int) -> None:
    """Raise UserError if images are too small for SSIM.

    Args:
        size: Width and height, pixels.
        resolution: What was asked for.
    """
    if min(size) < WINDOW:
        expected = f"images of at least {WINDOW} pixels a side"
        raise UserError(f"--resolution {resolution}", expected=expected, found=f"{size[0]} x {size[1]}")


def _extended(begun: Begun, config: TrainConfig, *, frames: int, out: Path) -> Schedule:
    """The schedule of a run that goes on: its own, unless another length is asked for.

    Then the length is what is asked for, whatever other limit the run had.

    Raises:
        UserError: It is to be shorter than it was.
    """
    asked = {name: getattr(config, name) for name in LENGTH if getattr(config, name) is not None}
    if all(value == begun.settings[name] for name, value in asked.items()):
        return begun.schedule
    limits = {"epochs": frames, "max_steps": 1}
    name, steps = min(
        ((name, value * limits[name]) for name, value in asked.items()), key=lambda limit: limit[1]
    )
    if steps < begun.schedule.steps:
        raise UserError(
            f"{out}: {option(name)}",
            expected=f"{begun.schedule.steps} steps as the run was begun, or more to extend it",
            found=f"{steps}",
        )
    return begun.schedule if steps == begun.schedule.steps else begun.schedule.extended(steps, at=begun.step)
