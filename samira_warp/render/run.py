"""Rendering a sequence to image files and videos, or one frame to a contact sheet of lights."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from samira_warp.avatar import Avatar, DrivingFrame, MaterialEdit, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.geometry.camera import Camera
from samira_warp.io.files import check_writable
from samira_warp.io.images import write_png
from samira_warp.light import Environment, LightRig
from samira_warp.render.config import RenderConfig
from samira_warp.render.sources import select_frames
from samira_warp.render.views import Views, place_cameras, warn_of_enlargement
from samira_warp.render.writing import display_values, left_over, write_layer
from samira_warp.stage.background import Background
from samira_warp.stage.layer_names import Layer
from samira_warp.stage.layers import can_be_transparent, layer_image
from samira_warp.stage.lights import (
    read_light,
    read_sheet_light,
    sheet_labels,
    sheet_paths,
    suiting_exposure,
    suiting_tone_map,
)
from samira_warp.stage.scene import PosedView, Scene
from samira_warp.stage.sheet import contact_sheet
from samira_warp.stage.turntable import plan_shots
from samira_warp.stage.video import VideoWriter, film_size
from samira_warp.stage.viewpoint import parse_viewpoint
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError

SHEET_NAME = "contact_sheet"


@torch.no_grad()
def render(config: RenderConfig) -> int:
    """Render every chosen frame of a sequence and write its layers.

    Under a folder of maps, the first frame becomes a contact sheet. Everything is checked before the first
    file is written.

    Returns:
        Number of pictures of each layer.

    Raises:
        UserError: The avatar, the sequence, the light or an option cannot be used.
    """
    config.check()
    edits, maps = material_edits(config), sheet_paths(config.env, ldr=config.ldr)
    if maps is not None and config.films is not None:
        raise UserError(config.films, expected="one light", found=_found_sheet(config))
    if config.background == "transparent":
        _check_transparent(config, sheet=maps is not None)
    if config.camera is not None:
        parse_viewpoint(config.camera)
    rig = None if config.lights is None else LightRig.load(config.lights)
    check_writable(config.out)
    device = pick_device(config.device)
    folder = find_avatar(config.avatar)
    avatar = Avatar.load(folder, device=device)
    frames, (trained, *_) = select_frames(config, avatar, folder), read_frames(folder)
    views = place_cameras(config, avatar, frames, trained)
    color_space = avatar.settings.color_space
    tone_map = suiting_tone_map(config.tone_map, config.env, rig=rig, color_space=color_space)
    background = Background(config.background, color_space=color_space, tone_map=tone_map)
    shadows = _casts_shadows(config, avatar)
    scene = Scene(avatar, edits, background, shadows=shadows, tone_map=tone_map)
    warn_of_enlargement(views.scale, trained)
    if maps is not None:
        return _render_sheet(config, scene, views.frames[0], maps, rig)
    return _render_sequence(config, scene, views, rig)


def _found_sheet(config: RenderConfig) -> str:
    return f"--env {config.env[0]}, a folder of maps, which makes a contact sheet"


def _check_transparent(config: RenderConfig, *, sheet: bool) -> None:
    """Raise UserError unless every file that is asked for can be without a background."""
    option = "--background transparent"
    if config.films is not None:
        raise UserError(option, expected="pictures alone: films hold no alpha", found=config.films)
    if sheet:
        raise UserError(option, expected="one light: sheets are white", found=_found_sheet(config))
    for layer in config.layers:
        if not can_be_transparent(layer):
            raise UserError(
                option, expected="layers that show the head on something", found=f"--layers {layer}"
            )


def _casts_shadows(config: RenderConfig, avatar: Avatar) -> bool:
    """Whether the head blocks the light: as asked, but not a learned light whose shadows are painted in."""
    other_light = bool(config.env) or config.lights is not None
    return config.shadows == "on" and (avatar.settings.visibility or other_light)


def material_edits(config: RenderConfig) -> tuple[MaterialEdit, ...]:
    """The edit that the options ask for, or none.

    Raises:
        UserError: An option is not of its form, or regions are named but nothing to change in them.
    """
    regions = tuple(name for text in config.region for name in text.split(","))
    edit = MaterialEdit(config.roughness, config.specular, config.albedo, regions)
    if not edit.changes() and regions:
        raise UserError(
            "--region", expected="--roughness, --specular or --albedo with it", found="none of them"
        )
    return (edit,) if edit.changes() else ()


def _render_sequence(config: RenderConfig, scene: Scene, views: Views, rig: LightRig | None) -> int:
    light = scene.light(_light(config, scene.avatar, rig))
    shots = plan_shots(
        views.frames, turntable=config.turntable, orbit=views.orbit, frames_per_second=config.fps
    )
    names = [picture.name for shot in shots for picture in shot.pictures]
    filmed = () if config.films is None else config.layers
    _say_what_stays(config, names, films=bool(filmed))
    if filmed:
        _say_film_size([frame.camera for frame in views.frames])
    _make_folders(config)
    with ExitStack() as stack:
        videos = {
            layer: stack.enter_context(VideoWriter(config.out / f"{layer}.mp4", frames_per_second=config.fps))
            for layer in filmed
        }
        bar = stack.enter_context(tqdm(total=len(names), unit="frame", dynamic_ncols=True))
        for shot in shots:
            view = scene.view(shot.frame)
            for name, camera, degrees in shot.pictures:
                moved = camera is not shot.frame.camera
                seen = scene.seen_from(view, camera) if moved else view
                rendering = scene.relight(seen, light.turned(degrees))
                for layer in config.layers:
                    image = layer_image(rendering, layer, transparent=scene.background.transparent)
                    picture = write_layer(config.out / layer, name, image)
                    if layer in videos:
                        videos[layer].add(picture)
                bar.update()
    return len(names)


def _render_sheet(
    config: RenderConfig, scene: Scene, frame: DrivingFrame, maps: list[Path], rig: LightRig | None
) -> int:
    view = scene.view(frame)
    lights = [_sheet_light(config, scene, view, path, rig) for path in maps]
    pictures: dict[Layer, list[np.ndarray]] = {layer: [] for layer in config.layers}
    for environment, behind in tqdm(lights, unit="light", dynamic_ncols=True):
        rendering = scene.shade(view, environment.filtered(), behind)
        for layer, row in pictures.items():
            row.append(display_values(layer_image(rendering, layer)))
    _say_what_stays(config, [SHEET_NAME], films=False)
    _make_folders(config)
    for layer, row in pictures.items():
        write_png(config.out / layer / f"{SHEET_NAME}.png", contact_sheet(row, sheet_labels(maps)))
    return 1


def _light(config: RenderConfig, avatar: Avatar, rig: LightRig | None) -> Environment:
    """The light of an image sequence: what --env and --lights name, else the learned light."""
    if config.env or rig is not None:
        exposure = suiting_exposure(config.exposure, config.env, rig=rig)
        return read_light(config.env, rig=rig, rotate=config.rotate, exposure=exposure, ldr=config.ldr)
    learned = avatar.light.environment().turned(config.rotate)
    return learned.exposed(suiting_exposure(config.exposure, config.env, rig=rig), name="the learned light")


def _sheet_light(
    config: RenderConfig, scene: Scene, view: PosedView, path: Path, rig: LightRig | None
) -> tuple[Environment, Tensor | float]:
    """Read a light of a contact sheet, and what is behind the head of it.

    All are read before the work on any begins, and none keeps its map, which may be large.
    """
    environment = read_sheet_light(
        path,
        rig=rig,
        rotate=config.rotate,
        exposure=suiting_exposure(config.exposure, config.env, rig=rig),
        ldr=config.ldr,
    )
    environment = environment.to(scene.device)
    return replace(environment, backdrop=None), scene.behind(view, environment)


def _say_what_stays(config: RenderConfig, names: list[str], *, films: bool) -> None:
    """Say which files of an earlier rendering will be among those of this one."""
    stay = left_over(config.out, names, layers=config.layers, films=films)
    if stay:
        count = f"{len(stay)} file{'s' * (len(stay) > 1)} of an earlier rendering"
        print(f"note: {config.out} keeps {count}, such as {stay[0].relative_to(config.out)}", file=sys.stderr)


def _say_film_size(cameras: list[Camera]) -> None:
    """Say so where the film has another size than some of its pictures."""
    first, *others = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    film = film_size(*first)
    if not others and film == first:
        return
    pictures = " or ".join(f"{width} x {height}" for width, height in (first, *others))
    reasons = ["H.264 holds even sizes only"] if film != first else []
    if others:
        reasons.append("it has its first picture's shape, and others are fitted into it on white")
    sizes = "the film is {} x {} and its pictures {}".format(*film, pictures)
    print(f"note: {sizes}: {'; '.join(reasons)}", file=sys.stderr)


def _make_folders(config: RenderConfig) -> None:
    for layer in config.layers:
        (config.out / layer).mkdir(parents=True, exist_ok=True)
