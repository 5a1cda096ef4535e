"""What is shown, from the options: the avatars, and the frames that move them."""

from __future__ import annotations

from pathlib import Path

import torch

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.support.errors import UserError
from samira_warp.view.carried import Carrier
from samira_warp.view.config import ViewConfig
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Shown


def load_shown(config: ViewConfig, device: torch.device) -> Shown:
    """The avatar that the options name, and what moves it.

    Raises:
        UserError: It cannot be used, or the sequence cannot drive it.
    """
    folder = _folder(config)
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


def _folder(config: ViewConfig) -> Path:
    """The avatar's folder. What trains is loaded only where a run is followed: the page opens sooner."""
    if config.avatar is not None:
        return find_avatar(config.avatar)
    from samira_warp.view.runs import newest_avatar

    assert config.run is not None
    return newest_avatar(config.run)


def _frames(config: ViewConfig, avatar: Avatar, folder: Path) -> list[DrivingFrame]:
    """The frames that drive: another sequence's, the avatar's own, or those that a run is training on."""
    if config.data is not None:
        from samira_warp.render.config import RenderConfig
        from samira_warp.render.sources import select_frames

        asked = RenderConfig(avatar=folder, out=Path(), data=config.data, split=config.split)
        return select_frames(asked, avatar, folder)
    if config.run is not None:
        from samira_warp.view.runs import is_finished, tracked_frames

        if not is_finished(config.run, folder):
            return tracked_frames(config.run, folder)
    return read_frames(folder)
