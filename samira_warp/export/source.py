"""What every format is written from."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.export.config import ExportConfig
from samira_warp.light import Environment, FilteredLight, LightRig
from samira_warp.stage.frames import chosen_frames, frame_at
from samira_warp.stage.lights import read_light, suiting_exposure, suiting_tone_map
from samira_warp.support.tone_names import ToneMap


@dataclass(frozen=True, eq=False)
class ExportSource:
    """An avatar that is about to be written, with all that the options decide, read and checked.

    Attributes:
        config: The options.
        folder: The avatar's folder.
        avatar: The avatar, on the CPU.
        frames: All of its own frames, test frames first; at least one.
        chosen: Those of them that are asked for, in their order; one for a format of one frame.
        light: What lights it, as turned and exposed; None where the albedo alone is asked for.
        shadows: Whether the head blocks that light.
        tone_map: What becomes of radiance before it is a colour.
    """

    config: ExportConfig
    folder: Path
    avatar: Avatar
    frames: tuple[DrivingFrame, ...]
    chosen: tuple[DrivingFrame, ...]
    light: Environment | None
    shadows: bool
    tone_map: ToneMap

    @functools.cached_property
    def filtered(self) -> FilteredLight | None:
        """The light as shading takes it, filtered once for all frames."""
        return None if self.light is None else self.light.filtered()

    @classmethod
    def read(cls, config: ExportConfig) -> ExportSource:
        """Read everything that checked options name.

        Raises:
            UserError: The avatar, the frames or the light cannot be used.
        """
        rig = None if config.lights is None else LightRig.load(config.lights)
        folder = find_avatar(config.avatar)
        avatar, frames = Avatar.load(folder), tuple(read_frames(folder))
        tone_map = suiting_tone_map(
            config.tone_map, config.env, rig=rig, color_space=avatar.settings.color_space
        )
        return cls(
            config,
            folder,
            avatar,
            frames,
            _chosen(config, frames),
            _light(config, avatar, rig),
            # an avatar that learned its light without shadows has them painted in
            shadows=avatar.settings.visibility or bool(config.env) or rig is not None,
            tone_map="none" if config.albedo else tone_map,
        )


def _chosen(config: ExportConfig, frames: tuple[DrivingFrame, ...]) -> tuple[DrivingFrame, ...]:
    sequence = config.kind.frames == "many" or config.frames is not None or config.split is not None
    if not sequence:
        return (frame_at(frames, config.frame or 0),)
    part = [frame for frame in frames if frame.part == (config.split or "test")]
    return tuple(chosen_frames(part, config.frames))


def _light(config: ExportConfig, avatar: Avatar, rig: LightRig | None) -> Environment | None:
    """What --env and --lights name, else the learned light; None for the albedo."""
    if config.albedo:
        return None
    exposure = suiting_exposure(config.exposure, config.env, rig=rig)
    if config.env or rig is not None:
        return read_light(config.env, rig=rig, rotate=config.rotate, exposure=exposure, ldr=config.ldr)
    learned = avatar.light.environment().turned(config.rotate)
    return learned.exposed(exposure, name="the learned light")
