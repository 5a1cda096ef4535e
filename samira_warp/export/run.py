"""From an avatar's folder to a file for other programs."""

from __future__ import annotations

from typing import NamedTuple

import torch

from samira_warp.avatar import Avatar, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.export.config import ExportConfig
from samira_warp.export.formats import FORMATS
from samira_warp.export.splats import frame_splats
from samira_warp.io.files import check_writable
from samira_warp.light import LightRig
from samira_warp.stage.frames import frame_at
from samira_warp.stage.lights import read_light


class Exported(NamedTuple):
    """What was written.

    Attributes:
        splats: How many Gaussians.
        frame: Name of the frame that they are of.
    """

    splats: int
    frame: str


@torch.no_grad()
def export(config: ExportConfig) -> Exported:
    """Write one frame of an avatar.

    Raises:
        UserError: The avatar, the frame, the light or an option cannot be used.
    """
    config.check()
    rig = None if config.lights is None else LightRig.load(config.lights)
    check_writable(config.out.parent)
    folder = find_avatar(config.avatar)
    avatar = Avatar.load(folder)
    frame = frame_at(read_frames(folder), config.frame)
    light = None
    if config.env or rig is not None:
        environment = read_light(
            config.env, rig=rig, rotate=config.rotate, exposure=config.exposure, ldr=config.ldr
        )
        light = environment.filtered()
    splats = frame_splats(avatar, frame, light)
    FORMATS[config.format](splats, config.out)
    return Exported(len(splats.means), frame.name)
