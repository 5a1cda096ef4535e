"""Checkpoints: a whole avatar folder, and what training needs beside it to go on with the same bits."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from samira_warp.avatar import Avatar
from samira_warp.avatar.storage import POSE_PARTS, joined_poses
from samira_warp.io.files import read_json, replace_folder, save_tensors
from samira_warp.support.errors import UserError
from samira_warp.train.density import DensityStatistics
from samira_warp.train.occlusions import FrameOcclusions
from samira_warp.train.row_adam import RowAdam
from samira_warp.train.shared_light import SharedLight
from samira_warp.train.tracking import TrackedParameters

KEPT = 2
"""Checkpoints that stay on the disk, the newest ones."""

TRAINING_FILE = "training.safetensors"
STEP_FILE = "training.json"


class TrainingState(NamedTuple):
    """What changes from step to step.

    Attributes:
        step: Number of steps done.
        avatar: The avatar.
        tracked: The training frames' parameters.
        light: The light, with what frames have asked of it since it last changed.
        occlusions: What the head blocks in them.
        optimizer: Adam, with its moments.
        density: Statistics since the last density control event.
    """

    step: int
    avatar: Avatar
    tracked: TrackedParameters
    light: SharedLight
    occlusions: FrameOcclusions
    optimizer: RowAdam
    density: DensityStatistics


def save_checkpoint(folder: Path, state: TrainingState, *, record: dict) -> Path:
    """Write ``folder``/step_NNNNNN, then drop older checkpoints and what a killed process left of one.

    A failure or an interrupt leaves the previous ones whole.
    """
    target = folder / f"step_{state.step:06d}"

    def write(fresh: Path) -> None:
        state.avatar.save(fresh, record=record)
        save_tensors(_training_tensors(state), fresh / TRAINING_FILE)
        (fresh / STEP_FILE).write_text(json.dumps({"step": state.step}), encoding="utf-8")

    replace_folder(target, write)
    for old in [*_checkpoints(folder)[:-KEPT], *folder.glob(".step_*")]:
        shutil.rmtree(old)
    return target


def last_checkpoint(folder: Path) -> Path:
    """The newest checkpoint of a run.

    Raises:
        UserError: There is none.
    """
    found = _checkpoints(folder)
    if not found:
        raise UserError(folder, expected="a checkpoint to resume from", found="none")
    return found[-1]


def checkpoint_step(path: Path) -> int:
    """The number of steps done at a checkpoint.

    Raises:
        UserError: The file that says so is broken.
    """
    step = read_json(path / STEP_FILE).get("step")
    if not isinstance(step, int):
        raise UserError(path / STEP_FILE, expected="the number of steps done", found=step)
    return step


def load_training(path: Path, state: TrainingState) -> int:
    """Put a checkpoint's training state into that of a trainer that was made for its avatar.

    Returns:
        The number of steps done.

    Raises:
        UserError: A file is missing or broken, or belongs to another avatar.
    """
    try:
        tensors = load_file(path / TRAINING_FILE)
    except (OSError, SafetensorError) as error:
        raise UserError(path / TRAINING_FILE, expected="the training state", found=error) from error
    try:
        tensors = _with_joined_poses(tensors)
        state.tracked.load_state_dict(_named(tensors, "tracked."))
        if state.avatar.settings.visibility:
            state.occlusions.load_state(_named(tensors, "occlusions."))
        state.light.load_state(_named(tensors, "light."))
        state.density.gradient.copy_(tensors["density.gradient"])
        state.density.views.copy_(tensors["density.views"])
    except (KeyError, RuntimeError) as error:
        misfit = str(error).splitlines()[-1].strip()
        raise UserError(
            path / TRAINING_FILE, expected="the training state of the avatar beside it", found=misfit
        ) from error
    for group in state.optimizer.param_groups:
        for index, parameter in enumerate(group["params"]):
            moments = _named(tensors, f"adam.{group['name']}.{index}.")
            if moments and group.get("rows") and moments["step"].dim() == 0:
                # older versions stepped all rows together
                moments["step"] = moments["step"].expand(len(parameter)).clone()
            if moments:
                state.optimizer.state[parameter] = {
                    name: value.to(parameter.device) for name, value in moments.items()
                }
    return checkpoint_step(path)


def _named(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    """Those whose name begins so, by the rest of it."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _training_tensors(state: TrainingState) -> dict[str, torch.Tensor]:
    tensors = {f"tracked.{name}": value for name, value in state.tracked.state_dict().items()}
    if state.avatar.settings.visibility:
        tensors |= {f"occlusions.{name}": value for name, value in state.occlusions.state().items()}
    tensors |= {f"light.{name}": value for name, value in state.light.state().items()}
    tensors |= {"density.gradient": state.density.gradient, "density.views": state.density.views}
    for group in state.optimizer.param_groups:
        for index, parameter in enumerate(group["params"]):
            for name, value in state.optimizer.state.get(parameter, {}).items():
                tensors[f"adam.{group['name']}.{index}.{name}"] = value
    return tensors


def _with_joined_poses(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The training state of any version as today's: older ones kept FLAME's poses and their moments apart.

    Raises:
        KeyError: One of them is missing.
    """
    if "tracked.rotation" not in tensors:
        return tensors
    old = {f"tracked.{part}": f"adam.pose.{index}." for index, part in enumerate(POSE_PARTS)}
    joined = {"tracked.rotations": joined_poses(*(tensors[name] for name in old))}
    for moment in ("exp_avg", "exp_avg_sq"):
        joined[f"adam.pose.0.{moment}"] = joined_poses(*(tensors[prefix + moment] for prefix in old.values()))
    joined["adam.pose.0.step"] = tensors["adam.pose.0.step"]
    kept = {name: value for name, value in tensors.items() if not name.startswith((*old, *old.values()))}
    return {**kept, **joined}


def _checkpoints(folder: Path) -> list[Path]:
    """Whole checkpoints, oldest first."""
    whole = (path for path in folder.glob("step_*") if (path / STEP_FILE).is_file())
    return sorted(whole, key=lambda path: int(path.name.removeprefix("step_")))
