"""What is shown, from the options: the avatars, the frames that move them, and where a run keeps both."""

from __future__ import annotations

from pathlib import Path

import torch

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.storage import TEMPLATE_FILE, find_avatar
from samira_warp.data import open_sequence
from samira_warp.io.files import read_json
from samira_warp.render.config import RenderConfig
from samira_warp.render.sources import select_frames
from samira_warp.support.errors import UserError
from samira_warp.train.begun import AVATAR_FOLDER, CHECKPOINTS_FOLDER, CONFIG_FILE
from samira_warp.train.checkpoint import last_checkpoint
from samira_warp.view.carried import Carrier
from samira_warp.view.config import ViewConfig
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Shown


def load_shown(config: ViewConfig, device: torch.device) -> Shown:
    """The avatar that the options name, and what moves it.

    Raises:
        UserError: It cannot be used, or the sequence cannot drive it.
    """
    folder = find_avatar(config.avatar) if config.avatar is not None else newest_avatar(_run(config))
    avatar = Avatar.load(folder, device=device)
    frames = _frames(config, avatar, folder)
    if not frames:
        raise UserError(config.data or folder, expected="frames that drive the avatar", found="none")
    return Shown(avatar, folder, Poser(frames, avatar.canonical.template))


def load_second(path: Path, first: Shown, device: torch.device) -> Shown:
    """The avatar beside the first, moved by the same frames.

    Raises:
        UserError: It cannot be used, or its head has too few of the first one's expressions.
    """
    folder = find_avatar(path)
    avatar = Avatar.load(folder, device=device)
    return Shown(avatar, folder, first.poser, Carrier.between(first.avatar, avatar, source=path))


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


def _run(config: ViewConfig) -> Path:
    assert config.run is not None
    return config.run


def _frames(config: ViewConfig, avatar: Avatar, folder: Path) -> list[DrivingFrame]:
    """The frames that drive: another sequence's, the avatar's own, or those that a run is training on."""
    if config.data is not None:
        asked = RenderConfig(avatar=folder, out=Path(), data=config.data, split=config.split)
        return select_frames(asked, avatar, folder)
    if config.run is None or folder == config.run / AVATAR_FOLDER:
        return read_frames(folder)
    return _tracked(config.run, folder)


def _tracked(run: Path, checkpoint: Path) -> list[DrivingFrame]:
    """The frames of a run's dataset as they were tracked: a checkpoint has none."""
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
