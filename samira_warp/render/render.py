"""Rendering a sequence to image files and videos."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.storage import DESCRIPTION_FILE, TEMPLATE_FILE, find_avatar
from samira_warp.camera import Camera
from samira_warp.data import open_sequence
from samira_warp.devices import pick_device
from samira_warp.errors import UserError
from samira_warp.files import read_json
from samira_warp.images import read_image, resize_box, to_uint8, write_exr, write_png
from samira_warp.light import Environment, encode_srgb
from samira_warp.render.config import RenderConfig, parse_frames
from samira_warp.render.layers import LayerImage, layer_image
from samira_warp.render.video import VideoWriter


@torch.no_grad()
def render(config: RenderConfig) -> int:
    """Render every chosen frame of a sequence and write its layers.

    Everything is checked before the first file is written.

    Returns:
        Number of frames.

    Raises:
        UserError: The avatar, the sequence, the light or an option cannot be used.
    """
    _check_numbers(config)
    device = pick_device(config.device)
    folder = find_avatar(config.avatar)
    avatar = Avatar.load(folder, device=device)
    frames = _select(config, avatar, folder)
    environment = _environment(config, avatar).to(device)
    background = _Background(config, environment, device)
    light = environment.filtered()
    for layer in config.layers:
        (config.out / layer).mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        videos = {
            layer: stack.enter_context(VideoWriter(config.out / f"{layer}.mp4", frames_per_second=config.fps))
            for layer in config.layers
            if config.video
        }
        for frame in tqdm(frames, unit="frame", dynamic_ncols=True):
            camera = frame.camera.to(device)
            rendering = avatar.render(frame.parameters, camera, light, background=background.behind(camera))
            for layer in config.layers:
                picture = _write(config.out / layer, frame.name, layer_image(rendering, layer))
                if layer in videos:
                    videos[layer].add(picture)
    return len(frames)


def _check_numbers(config: RenderConfig) -> None:
    ranges = {
        "exposure": (0.0 < config.exposure < math.inf, "a positive factor"),
        "rotate": (math.isfinite(config.rotate), "degrees"),
        "resolution": (config.resolution is None or config.resolution > 0, "a positive number of pixels"),
        "fps": (0.0 < config.fps < math.inf, "a positive number of frames"),
    }
    for name, (holds, expected) in ranges.items():
        if not holds:
            raise UserError(f"--{name}", expected=expected, found=getattr(config, name))


def _select(config: RenderConfig, avatar: Avatar, folder: Path) -> list[DrivingFrame]:
    """The frames to render, at the size to render them."""
    wanted, own = parse_frames(config.frames), read_frames(folder)
    frames = list(_own(config, own) if config.data is None else _driven(config, avatar, folder))
    chosen = frames[wanted]
    if not chosen:
        raise UserError("--frames", expected=f"some of the {len(frames)} frames", found=f"none in {config.frames or 'the split'}")
    longer = config.resolution or max(own[0].camera.width, own[0].camera.height)
    return [frame._replace(camera=_at_size(frame.camera, longer)) for frame in chosen]


def _own(config: RenderConfig, frames: list[DrivingFrame]) -> Iterator[DrivingFrame]:
    """The frames that are stored with the avatar."""
    part = config.split or "test"
    if part not in ("train", "test"):
        raise UserError("--split", expected="train or test of the avatar's own frames, or --data DIR", found=repr(part))
    return (frame for frame in frames if frame.part == part)


def _driven(config: RenderConfig, avatar: Avatar, folder: Path) -> Iterator[DrivingFrame]:
    """Frames of another sequence: its pose and expression, the avatar's own shape and static offset."""
    record = read_json(folder / DESCRIPTION_FILE)["record"]
    trained_on = record.get("subject") == config.data.resolve().name
    split = config.split or (record.get("split", "dataset") if trained_on else "dataset")
    sequence = open_sequence(config.data, split=split, flame=folder / TEMPLATE_FILE)
    own = avatar.canonical.template
    if sequence.template.hash != own.hash:
        raise UserError(sequence.template_path, expected=f"the avatar's head template ({own.hash[:12]})", found=sequence.template.hash[:12])
    same_person = torch.equal(sequence.shape, avatar.canonical.shape.cpu())
    for index in sequence.selected:
        frame = sequence.frames[index]
        parameters = frame.parameters if same_person else replace(frame.parameters, dynamic_offset=None)
        yield DrivingFrame(frame.name, parameters, frame.camera, sequence.split.part)


def _at_size(camera: Camera, longer: int) -> Camera:
    scale = longer / max(camera.width, camera.height)
    return camera.resized(width=max(round(camera.width * scale), 1), height=max(round(camera.height * scale), 1))


def _environment(config: RenderConfig, avatar: Avatar) -> Environment:
    if config.env is not None:
        return Environment.load(config.env, rotate=config.rotate, exposure=config.exposure)
    if config.rotate != 0.0:
        raise UserError("--rotate", expected="--env FILE, the map to turn", found="the learned light, which stays where it was captured")
    learned = avatar.light.environment()
    return Environment.from_cubemaps(learned.diffuse * config.exposure, learned.specular * config.exposure)


class _Background:
    """What is behind the head, in display values."""

    def __init__(self, config: RenderConfig, environment: Environment, device: torch.device) -> None:
        self._environment = environment if config.background == "env" else None
        self._grey = {"white": 1.0, "black": 0.0}.get(config.background)
        self._image: np.ndarray | None = None
        self._device = device
        if self._environment is None and self._grey is None:
            path = Path(config.background)
            if not path.is_file():
                raise UserError("--background", expected="white, black, env or an image file", found=repr(config.background))
            self._image = read_image(path, channels=3)

    def behind(self, camera: Camera) -> torch.Tensor | float:
        if self._environment is not None:
            return encode_srgb(self._environment.background(camera)).clamp(0.0, 1.0)
        if self._image is not None:
            return torch.from_numpy(resize_box(self._image, width=camera.width, height=camera.height)).to(self._device)
        return self._grey


def _write(folder: Path, name: str, layer: LayerImage) -> np.ndarray:
    """Write a layer's PNG, and its EXR where it has values; the picture comes back as (H, W, 3) bytes."""
    picture = layer.picture.clamp(0.0, 1.0).cpu().numpy()
    if picture.shape[2] == 1:
        picture = np.repeat(picture, 3, axis=2)
    write_png(folder / f"{name}.png", picture)
    if layer.values is not None:
        write_exr(folder / f"{name}.exr", layer.values.cpu().numpy())
    return to_uint8(picture)
