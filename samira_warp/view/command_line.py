"""What is shown as a command of the render verb, and what of it that verb cannot say."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar.storage.frames import FRAMES_FILE
from samira_warp.geometry.camera import Camera
from samira_warp.light import DirectionalLight
from samira_warp.stage.viewpoint import FARTHEST, NEAREST, HeadPlace, Viewpoint
from samira_warp.view.look import Look
from samira_warp.view.scene import Scene
from samira_warp.view.state import LEARNED, State

SAME_VIEW = 0.005
"""Degrees between two cameras' axes that are not worth a word: a fifth of a pixel where 18 fill 720."""

LAMP_FILE = "lamp.json"


class Said(NamedTuple):
    """A command, and what is missing from it.

    Attributes:
        words: The arguments after ``render``, but for the lamp's file.
        lamp: The content of `LAMP_FILE`, where the command needs it.
        missing: What the picture has that the command does not say.
    """

    words: tuple[str, ...]
    lamp: str | None
    missing: tuple[str, ...]

    def text(self) -> str:
        """As a shell takes it, comments included."""
        lines = [f"# not in the command: {what}" for what in self.missing]
        if self.lamp is not None:
            lines.append(f"echo {shlex.quote(self.lamp)} > {LAMP_FILE}")
        lines.append(shlex.join(("python", "-m", "samira_warp.render", *self.words)))
        return "\n".join(lines)


def command_of(scene: Scene, state: State, *, height: int, data: Path | None, split: str | None) -> Said:
    """The command that renders what is shown.

    Args:
        scene: The avatars and lights.
        state: What is chosen.
        height: Pixels of the picture, whose width is that of the training pictures' shape.
        data: The sequence that drives the avatar, None for its own frames.
        split: Its part, as it was asked for.
    """
    shown = scene.shown
    missing = [*_missing(state), *([] if _has_frames(shown.folder) else ["a checkpoint has no frames yet"])]
    pose = min(state.pose.frame, len(shown.poser.frames) - 1)
    frame, number = shown.poser.frames[pose], shown.poser.numbers[pose]
    words = ["--avatar", str(shown.folder), "--out", "rendered"]
    if data is not None:
        words += ["--data", str(data), *(["--split", split] if split is not None else [])]
    else:
        words += ["--split", frame.part]
    words += ["--frames", str(number)]
    camera, unseen = _camera(state.look, scene.place(state), frame.camera, height=height)
    light, lamp = _light(scene, state)
    words += [*camera, *light, *_materials(state)]
    if state.background != "white":
        words += ["--background", state.background]
    if state.layer != "image":
        words += ["--layers", state.layer]
    return Said(tuple(words), lamp, (*missing, *unseen))


def _has_frames(folder: Path) -> bool:
    return (folder / FRAMES_FILE).is_file()


def _missing(state: State) -> list[str]:
    """What render has no options for."""
    missing = []
    if state.pose.live is not None:
        missing.append("the live pose: render --drive records one")
    if state.pose.neutral:
        missing.append("the face at rest")
    if state.pose.expression or state.pose.joints:
        missing.append("what is added to the frame's expression and joints")
    if len(state.edits) > 1:
        missing.append("materials of more than one region; the first is")
    if state.comparison.of != "nothing":
        missing.append("what is beside it")
    if state.splats:
        missing.append("splats, which the browser draws in its own way")
    return missing


def _camera(look: Look, place: HeadPlace, lens: Camera, *, height: int) -> tuple[list[str], list[str]]:
    """The options of the camera, and how it differs from what they can say."""
    longer = max(round(height * lens.width / lens.height), height)
    viewpoint = viewpoint_of(look, place)
    said = viewpoint.camera(place, look.camera(height, height))
    field = _field_of_longer_side(look.fov, lens)
    words = [
        f"--camera={_number(viewpoint.yaw)},{_number(viewpoint.pitch)},{_number(viewpoint.distance)}",
        "--fov",
        _number(field),
        "--resolution",
        str(longer),
    ]
    away = _degrees_between(said.world_to_camera, look.camera(height, height).world_to_camera)
    missing = []
    if away > SAME_VIEW:
        missing.append(
            f"{away:.2g} degrees of the camera's turn: --camera looks at the head's centre, upright with it"
        )
    if viewpoint.distance in (NEAREST, FARTHEST):
        missing.append("the camera's distance")
    return words, missing


def viewpoint_of(look: Look, place: HeadPlace) -> Viewpoint:
    """Where a camera stands about a head, within what ``--camera`` takes."""
    position = torch.tensor(look.position, dtype=torch.float64)
    x, y, z = (place.axes.double().cpu().T @ (position - place.center.double().cpu())).tolist()
    distance = math.hypot(x, y, z)
    pitch = math.degrees(math.asin(max(-1.0, min(1.0, y / max(distance, 1e-9)))))
    return Viewpoint(math.degrees(math.atan2(x, z)), pitch, min(max(distance, NEAREST), FARTHEST))


def _field_of_longer_side(fov: float, lens: Camera) -> float:
    """Degrees of the longer side of a picture of the training pictures' shape, whose height spans ``fov``."""
    tangent = math.tan(math.radians(0.5 * fov)) * max(lens.width / lens.height, 1.0)
    return math.degrees(2.0 * math.atan(tangent))


def _degrees_between(one: Tensor, other: Tensor) -> float:
    """The angle by which one camera is turned against another."""
    turn = one[:3, :3].double() @ other[:3, :3].double().T
    sine = (
        0.5 * torch.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]).norm()
    )
    cosine = 0.5 * (turn.trace() - 1.0)
    return math.degrees(math.atan2(float(sine), float(cosine)))


def _light(scene: Scene, state: State) -> tuple[list[str], str | None]:
    """The options of the light, and the lamp's file."""
    light, avatar, lamp = state.light, scene.shown.avatar, None
    words = []
    if light.name != LEARNED:
        words += ["--env", str(scene.lights.paths[light.name])]
    elif light.lamp is not None:
        words += ["--env", str(scene.shown.folder)]
    if light.lamp is not None:
        (directional,) = scene.lights.rig(avatar, light).lamps
        assert isinstance(directional, DirectionalLight)
        lamp = json.dumps(
            {
                "lamps": [
                    {
                        "kind": "directional",
                        "direction": directional.direction,
                        "irradiance": directional.irradiance,
                    }
                ]
            }
        )
        words += ["--lights", LAMP_FILE]
    if light.rotate:
        words += ["--rotate", _number(light.rotate)]
    if light.stops or light.lamp is not None:
        words += ["--exposure", repr(scene.lights.exposure(avatar, light))]
    if not light.shadows:
        words += ["--shadows", "off"]
    # what render takes on its own
    foreign = scene.lights.is_foreign(light) or light.lamp is not None
    usual = "filmic" if foreign and avatar.settings.color_space != "raw" else "none"
    tone_map = scene.tone_map(avatar, state)
    return words + (["--tone-map", tone_map] if tone_map != usual else []), lamp


def _materials(state: State) -> list[str]:
    """The options of the first region's materials."""
    if not state.edits:
        return []
    edit = state.edits[0]
    words = [word for region in edit.regions for word in ("--region", region)]
    for name in ("roughness", "specular", "albedo"):
        value = getattr(edit, name)
        if value is not None:
            words += [f"--{name}", value]
    return words


def _number(value: float) -> str:
    """A number as it is typed: nine digits are finer than a float32 camera."""
    return f"{value:.9g}"
