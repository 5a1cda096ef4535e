"""Rendering a sequence to image files and videos, or one frame to a contact sheet of lights."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from tqdm import tqdm

from samira_warp.avatar import Avatar, DrivingFrame, GBuffer, MaterialEdit, Motion, Rendering
from samira_warp.avatar.storage import find_avatar
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import to_uint8, write_exr, write_png
from samira_warp.light import Environment, FilteredLight
from samira_warp.light.environment import check_exposure
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.render.background import Background
from samira_warp.render.config import RenderConfig, material_edits
from samira_warp.render.layers import LayerImage, layer_image
from samira_warp.render.lights import one_light, sheet_labels, sheet_light, sheet_paths
from samira_warp.render.sources import select_frames
from samira_warp.render.turntable import plan_shots
from samira_warp.render.video import VideoWriter
from samira_warp.stage.contact_sheet import contact_sheet
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError

SHEET_NAME = "contact_sheet"


class View(NamedTuple):
    """What of a frame does not depend on the light.

    Attributes:
        camera: The view.
        motion: The posed head.
        gbuffer: Its surface, as the camera sees it.
    """

    camera: Camera
    motion: Motion
    gbuffer: GBuffer


class Light(NamedTuple):
    """A light as it is used for every picture.

    Attributes:
        filtered: What shading needs of it.
        seen: What is behind the head of it, in display values; None where something else is.
    """

    filtered: FilteredLight
    seen: RadianceMap | None


class SheetLight(NamedTuple):
    """A light as it is used for one picture.

    Attributes:
        environment: The light, without its map.
        behind: Display values behind the head, (H, W, 3) or a grey.
    """

    environment: Environment
    behind: torch.Tensor | float


class Stage(NamedTuple):
    """The avatar as it is to be shown.

    Attributes:
        avatar: The avatar, on its device.
        edits: Changes to its materials.
        background: What is behind it.
    """

    avatar: Avatar
    edits: tuple[MaterialEdit, ...]
    background: Background

    def view(self, frame: DrivingFrame) -> View:
        """Move the head and rasterise it."""
        device = self.avatar.gaussians.means.device
        camera, motion = frame.camera.to(device), self.avatar.move(frame.parameters.to(device))
        return View(camera, motion, self.avatar.rasterize(motion, camera, edits=self.edits))

    def light(self, environment: Environment) -> Light:
        """Filter an environment, once for all pictures."""
        environment = environment.to(self.avatar.gaussians.means.device)
        return Light(environment.filtered(), self.background.view_of(environment))

    def relight(self, view: View, light: Light, *, rotate: float) -> Rendering:
        """Shade a view under a light that is turned by so many degrees, and put the background behind it."""
        return self.shade(
            view,
            light.filtered,
            self.background.behind(view.camera, light.seen, rotate=rotate),
            rotate=rotate,
        )

    def shade(
        self, view: View, light: FilteredLight, behind: torch.Tensor | float, *, rotate: float
    ) -> Rendering:
        """Shade a view and put display values behind it."""
        return self.avatar.shade(
            view.motion, view.gbuffer, view.camera, light, rotate=rotate, background=behind
        )


@torch.no_grad()
def render(config: RenderConfig) -> int:
    """Render every chosen frame of a sequence and write its layers; under a folder of maps, the first frame
    as a contact sheet.

    Everything is checked before the first file is written.

    Returns:
        Number of pictures of each layer.

    Raises:
        UserError: The avatar, the sequence, the light or an option cannot be used.
    """
    _check_numbers(config)
    edits, maps = material_edits(config), sheet_paths(config)
    if maps is not None and (config.turntable is not None or config.video):
        option = "--video" if config.turntable is None else "--turntable"
        raise UserError(
            option,
            expected="one light",
            found=f"--env {config.env[0]}, a folder of maps, which makes a contact sheet",
        )
    device = pick_device(config.device)
    folder = find_avatar(config.avatar)
    avatar = Avatar.load(folder, device=device)
    frames = select_frames(config, avatar, folder)
    stage = Stage(avatar, edits, Background(config.background, avatar))
    if maps is not None:
        return _render_sheet(config, stage, frames[0], maps)
    return _render_sequence(config, stage, frames)


def _check_numbers(config: RenderConfig) -> None:
    check_exposure(config.exposure, name="--exposure")
    ranges = {
        "expression-gain": (math.isfinite(config.expression_gain), "a number"),
        "rotate": (math.isfinite(config.rotate), "degrees"),
        "turntable": (
            config.turntable is None or 0.0 < config.turntable < math.inf,
            "a positive number of seconds",
        ),
        "resolution": (config.resolution is None or config.resolution > 0, "a positive number of pixels"),
        "fps": (0.0 < config.fps < math.inf, "a positive number of frames"),
    }
    for name, (holds, expected) in ranges.items():
        if not holds:
            raise UserError(f"--{name}", expected=expected, found=getattr(config, name.replace("-", "_")))


def _render_sequence(config: RenderConfig, stage: Stage, frames: list[DrivingFrame]) -> int:
    light = stage.light(one_light(config, stage.avatar))
    shots = plan_shots(frames, rotate=config.rotate, turntable=config.turntable, frames_per_second=config.fps)
    count = sum(len(shot.pictures) for shot in shots)
    _make_folders(config)
    with ExitStack() as stack:
        videos = {
            layer: stack.enter_context(VideoWriter(config.out / f"{layer}.mp4", frames_per_second=config.fps))
            for layer in config.layers
            if config.video or config.turntable is not None
        }
        bar = stack.enter_context(tqdm(total=count, unit="frame", dynamic_ncols=True))
        for shot in shots:
            view = stage.view(shot.frame)
            for name, degrees in shot.pictures:
                rendering = stage.relight(view, light, rotate=degrees)
                for layer in config.layers:
                    picture = _write(config.out / layer, name, layer_image(rendering, layer))
                    if layer in videos:
                        videos[layer].add(picture)
                bar.update()
    return count


def _render_sheet(config: RenderConfig, stage: Stage, frame: DrivingFrame, maps: list[Path]) -> int:
    view = stage.view(frame)
    lights = [_sheet_light(config, stage, view.camera, path) for path in maps]
    pictures: dict[str, list[np.ndarray]] = {layer: [] for layer in config.layers}
    for light in tqdm(lights, unit="light", dynamic_ncols=True):
        rendering = stage.shade(view, light.environment.filtered(), light.behind, rotate=config.rotate)
        for layer, row in pictures.items():
            row.append(_display(layer_image(rendering, layer)))
    _make_folders(config)
    for layer, row in pictures.items():
        write_png(config.out / layer / f"{SHEET_NAME}.png", contact_sheet(row, sheet_labels(maps)))
    return 1


def _sheet_light(config: RenderConfig, stage: Stage, camera: Camera, path: Path) -> SheetLight:
    """Read a light of a contact sheet. All are read before the work on any begins, and none keeps its map,
    which may be large.
    """
    environment = sheet_light(config, path).to(camera.world_to_camera.device)
    behind = stage.background.behind(camera, stage.background.view_of(environment), rotate=config.rotate)
    return SheetLight(replace(environment, backdrop=None), behind)


def _make_folders(config: RenderConfig) -> None:
    for layer in config.layers:
        (config.out / layer).mkdir(parents=True, exist_ok=True)


def _write(folder: Path, name: str, layer: LayerImage) -> np.ndarray:
    """Write a layer's PNG, and its EXR where it has values; the picture comes back as (H, W, 3) bytes."""
    picture = _display(layer)
    write_png(folder / f"{name}.png", picture)
    if layer.values is not None:
        write_exr(folder / f"{name}.exr", layer.values.cpu().numpy())
    return to_uint8(picture)


def _display(layer: LayerImage) -> np.ndarray:
    """(H, W, 3) display values of a layer in 0..1."""
    picture = layer.picture.clamp(0.0, 1.0).cpu().numpy()
    return np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture
