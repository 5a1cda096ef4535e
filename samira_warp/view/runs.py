"""A run folder whose training is under way: its newest avatar, and the frames that move it."""

from __future__ import annotations

from pathlib import Path

from samira_warp.avatar import DrivingFrame
from samira_warp.avatar.storage import TEMPLATE_FILE, find_avatar
from samira_warp.data import open_sequence
from samira_warp.io.files import read_json
from samira_warp.support.errors import UserError
from samira_warp.train.begun import AVATAR_FOLDER, CHECKPOINTS_FOLDER, CONFIG_FILE
from samira_warp.train.checkpoint import last_checkpoint


def newest_avatar(run: Path) -> Path:
    """The folder of a run's avatar: the finished one, or its last checkpoint.

    Raises:
        UserError: The run has neither yet.
    """
    if not (run / CONFIG_FILE).is_file():
        raise UserError(run, expected="a run folder", found=f"no {CONFIG_FILE} in it")
    if (run / AVATAR_FOLDER).is_dir():
        return find_avatar(run / AVATAR_FOLDER)
    checkpoints = run / CHECKPOINTS_FOLDER
    if not any(checkpoints.glob("step_*")):
        raise UserError(checkpoints, expected="a first checkpoint to show", found="none yet")
    return last_checkpoint(checkpoints)


def is_finished(run: Path, folder: Path) -> bool:
    """Whether an avatar's folder is that of the finished run, which has its own frames."""
    return folder == run / AVATAR_FOLDER


def tracked_frames(run: Path, checkpoint: Path) -> list[DrivingFrame]:
    """The frames of a run's dataset as they were tracked: a checkpoint has none.

    Raises:
        UserError: The run does not say what it trains on, or that is not there.
    """
    path = run / CONFIG_FILE
    settings = read_json(path).get("settings")
    if not isinstance(settings, dict) or not {"data", "split"} <= set(settings):
        raise UserError(path, expected="the settings of a run", found=type(settings).__name__)
    sequence = open_sequence(
        Path(settings["data"]), split=settings["split"], flame=checkpoint / TEMPLATE_FILE
    )
    parts = [(index, "test") for index in sequence.test] + [(index, "train") for index in sequence.train]
    frames = sequence.frames
    return [
        DrivingFrame(frames[index].name, frames[index].parameters, frames[index].camera, part)
        for index, part in parts
    ]
