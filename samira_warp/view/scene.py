"""What is chosen, made into a picture; knows no browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from samira_warp.avatar import Avatar, GBuffer, Motion, Rendering
from samira_warp.avatar.gbuffer import blend_arrival
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters
from samira_warp.io.images import to_uint8
from samira_warp.render.writing import display_values
from samira_warp.stage.background import Background
from samira_warp.stage.fitting import fitted
from samira_warp.stage.layers import layer_image
from samira_warp.stage.viewpoint import HeadPlace
from samira_warp.support.tone_names import ToneMap
from samira_warp.surface import LIGHT_CHANNELS
from samira_warp.view.carried import Carrier
from samira_warp.view.lights import Detail, Lights, Lit
from samira_warp.view.posing import Poser
from samira_warp.view.splats import BrowserSplats, shaded_splats
from samira_warp.view.stages import Stages
from samira_warp.view.state import Light, Pose, State


class Shown(NamedTuple):
    """An avatar and what moves it.

    Attributes:
        avatar: On its device.
        folder: Where it is, for the command line that shows it.
        poser: The frames that drive it, with what is added.
        carrier: From the sequence's head to the avatar's; None where they are one.
    """

    avatar: Avatar
    folder: Path
    poser: Poser
    carrier: Carrier | None = None

    def parameters(self, pose: Pose) -> FrameParameters:
        """The avatar's own parameters, on its device."""
        parameters = self.poser.parameters(pose)
        if self.carrier is not None:
            parameters = self.carrier.carry(parameters)
        return parameters.to(self.avatar.canonical.vertices.device)


class Sides(NamedTuple):
    """What is kept of the two parts of a browser's picture."""

    left: Stages
    right: Stages

    @classmethod
    def new(cls) -> Sides:
        """With nothing kept."""
        return cls(Stages(), Stages())


class Scene:
    """The avatars and the lights, for any number of browsers; each brings what is kept of its own."""

    def __init__(self, shown: Shown, lights: Lights, *, second: Shown | None = None) -> None:
        self.shown, self.lights, self.second = shown, lights, second

    @property
    def device(self) -> torch.device:
        """Where the avatars are."""
        return self.shown.avatar.canonical.vertices.device

    def replace_avatar(self, avatar: Avatar, folder: Path) -> None:
        """Show a newer state of the avatar."""
        self.shown = self.shown._replace(avatar=avatar, folder=folder)
        self.lights.forget()

    @torch.no_grad()
    def picture(
        self, state: State, sides: Sides, *, width: int, height: int, detail: Detail = "full"
    ) -> np.ndarray:
        """(H, W, 3) uint8 display values of what is chosen."""
        left = self._drawn(self.shown, state, sides.left, width=width, height=height, detail=detail)
        comparison = state.comparison
        if comparison.of == "nothing" or (comparison.of == "avatar" and self.second is None):
            return left
        beside, shown = state, self.shown
        if comparison.of == "light":
            beside = replace(state, light=comparison.light)
        elif self.second is not None:
            shown = self.second
        right = self._drawn(shown, beside, sides.right, width=width, height=height, detail=detail)
        return split(left, right, at=comparison.split)

    @torch.no_grad()
    def rendering(
        self, state: State, stages: Stages, camera: Camera, *, detail: Detail = "full"
    ) -> Rendering:
        """The shaded left part of what is chosen, through a camera."""
        return self._rendering(self.shown, state, stages, camera, detail=detail)

    @torch.no_grad()
    def splats(self, state: State, stages: Stages, *, detail: Detail = "full") -> BrowserSplats:
        """The avatar that is chosen as splats, shaded for an eye where the camera is."""
        avatar, light = self.shown.avatar, state.light
        camera = state.look.camera(1, 1).to(self.device)
        posed = (avatar, state.pose)
        motion = stages.motion.get(posed, lambda: avatar.move(self.shown.parameters(state.pose)))
        lit, arrival = self.lights.lit(avatar, light, detail=detail), None
        if self.casts_shadows(avatar, light):
            arrival = _arrival(avatar, posed, motion, lit, camera, stages)
        return shaded_splats(
            avatar,
            motion,
            lit.filtered,
            eye=camera.center,
            arrival=arrival,
            edits=state.edits,
            tone_map=self.tone_map(avatar, state),
        )

    @torch.no_grad()
    def place(self, state: State) -> HeadPlace:
        """Where the head is."""
        canonical = self.shown.avatar.canonical
        return HeadPlace.of(canonical, canonical.pose(self.shown.parameters(state.pose)))

    def casts_shadows(self, avatar: Avatar, light: Light) -> bool:
        """Whether the head blocks a light; a learned light may have its shadows painted into the rest."""
        foreign = self.lights.is_foreign(light) or light.lamp is not None
        return light.shadows and (avatar.settings.visibility or foreign)

    def tone_map(self, avatar: Avatar, state: State) -> ToneMap:
        """What brings radiance into the range of the display; image values stay as they are."""
        if avatar.settings.color_space == "raw":
            return "none"
        if state.tone_map != "auto":
            return state.tone_map
        return "filmic" if self.lights.is_foreign(state.light) else "none"

    def _drawn(
        self, shown: Shown, state: State, stages: Stages, *, width: int, height: int, detail: Detail
    ) -> np.ndarray:
        rendering = self._rendering(shown, state, stages, state.look.camera(width, height), detail=detail)
        picture = to_uint8(display_values(layer_image(rendering, state.layer)))
        if picture.shape[:2] != (height, width):  # a map of the atlas
            picture = fitted(picture, width=width, height=height)
        return picture

    def _rendering(
        self, shown: Shown, state: State, stages: Stages, camera: Camera, *, detail: Detail
    ) -> Rendering:
        avatar, light = shown.avatar, state.light
        camera = camera.to(avatar.canonical.vertices.device)
        posed = (avatar, state.pose)
        seen = (*posed, _key(camera), state.edits)
        motion = stages.motion.get(posed, lambda: avatar.move(shown.parameters(state.pose)))
        lit = self.lights.lit(avatar, light, detail=detail, seen=state.background == "env")
        casts, tone_map = self.casts_shadows(avatar, light), self.tone_map(avatar, state)

        def surface() -> GBuffer:
            def rasterized(arrival: torch.Tensor | None = None) -> GBuffer:
                return avatar.rasterize(motion, camera, edits=state.edits, arrival=arrival)

            if not casts:
                return unlit(stages.surface.get(seen, rasterized))
            arrival = _arrival(avatar, posed, motion, lit, camera, stages)
            if stages.surface.holds(seen):
                return blend_arrival(stages.surface.get(seen, rasterized), arrival)
            # what arrives is blended with the rest, in one pass
            return stages.surface.get(seen, lambda: rasterized(arrival))

        turned = (*lit.key, light.rotate)
        lit_surface = stages.lit.get((*seen, *turned, casts), surface)
        background = Background(state.background, color_space=avatar.settings.color_space, tone_map=tone_map)

        def shaded() -> Rendering:
            exposed = (*lit.key, light.stops, tone_map)
            backdrop = stages.backdrop.get(exposed, lambda: background.seen_of(lit.environment))
            behind = background.behind(camera, backdrop, rotate=light.rotate)
            return avatar.shade(
                motion, lit_surface, camera, lit.filtered, background=behind, tone_map=tone_map
            )

        key = (*seen, *turned, light.stops, casts, tone_map, state.background)
        return stages.rendering.get(key, shaded)


def _arrival(
    avatar: Avatar, posed: tuple[object, ...], motion: Motion, lit: Lit, camera: Camera, stages: Stages
) -> torch.Tensor:
    """`Avatar.arrival`, whose diffuse part a camera that moves leaves as it is, and whose glints a light."""
    occluder = avatar.occluder
    occlusion = stages.occlusion.get(posed, lambda: occluder.occlude(motion.head))
    turned, seen_from = (*lit.key, lit.filtered.rotate), tuple(camera.center.tolist())
    shares = stages.shares.get((occlusion, *turned), lambda: occluder.shares(occlusion, lit.filtered))
    lobes = stages.lobes.get((occlusion, *seen_from), lambda: occluder.lobes(occlusion, camera))
    return avatar.arrival_from(torch.cat([shares, lobes, occlusion.openness], dim=1))


def unlit(surface: GBuffer) -> GBuffer:
    """A G-buffer that says nothing of any light, whatever it was made with."""
    neutral: dict[str, Any] = {name: torch.ones_like(getattr(surface, name)) for name in LIGHT_CHANNELS}
    return replace(surface, **neutral)


def split(left: np.ndarray, right: np.ndarray, *, at: float) -> np.ndarray:
    """(H, W, 3) uint8: the left of one picture and the right of another, a white line between them.

    Args:
        left: (H, W, 3) uint8.
        right: Likewise.
        at: Share of the width at which the right one begins.
    """
    width = left.shape[1]
    column = min(max(round(at * width), 0), width)
    both = np.concatenate([left[:, :column], right[:, column:]], axis=1)
    if 0 < column < width:
        both[:, column - 1 : column + 1] = 255
    return both


def _key(camera: Camera) -> tuple[object, ...]:
    """Equal for equal cameras."""
    transform = tuple(camera.world_to_camera.flatten().tolist())
    return (transform, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
