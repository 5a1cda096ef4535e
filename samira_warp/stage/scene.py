"""An avatar with its edits and what is behind it: posed once, lit as often as one likes."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar import Avatar, DrivingFrame, GBuffer, MaterialEdit, Motion, Rendering
from samira_warp.avatar.occlusion import Occlusion
from samira_warp.geometry.camera import Camera
from samira_warp.light import Environment, FilteredLight
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.stage.background import Background
from samira_warp.support.tone_names import ToneMap


class PosedView(NamedTuple):
    """What of a frame does not depend on the light.

    Attributes:
        camera: The view.
        motion: The posed head.
        gbuffer: Its surface, as the camera sees it.
        occlusion: Which directions it blocks; None where it casts no shadows.
    """

    camera: Camera
    motion: Motion
    gbuffer: GBuffer
    occlusion: Occlusion | None


class SceneLight(NamedTuple):
    """A light as it is used for many pictures.

    Attributes:
        filtered: What shading needs of it.
        seen: What is behind the head of it, in display values, not turned; None where something else is.
    """

    filtered: FilteredLight
    seen: RadianceMap | None

    def turned(self, degrees: float) -> SceneLight:
        """The same light turned by so many degrees more, before the head and behind it."""
        return self._replace(filtered=self.filtered.turned(degrees))


class Scene(NamedTuple):
    """The avatar as it is to be shown.

    Attributes:
        avatar: The avatar, on its device.
        edits: Changes to its materials.
        background: What is behind it.
        shadows: Whether it blocks the light.
        tone_map: What brings its radiance into the range of a display; the background has its own.
    """

    avatar: Avatar
    edits: tuple[MaterialEdit, ...]
    background: Background
    shadows: bool = True
    tone_map: ToneMap = "none"

    @property
    def device(self) -> torch.device:
        """Where the avatar is."""
        return self.avatar.canonical.vertices.device

    def view(self, frame: DrivingFrame) -> PosedView:
        """Move the head, rasterise it, and trace what it blocks."""
        camera, motion = frame.camera.to(self.device), self.avatar.move(frame.parameters.to(self.device))
        gbuffer = self.avatar.rasterize(motion, camera, edits=self.edits)
        occlusion = self.avatar.occluder.occlude(motion.head) if self.shadows else None
        return PosedView(camera, motion, gbuffer, occlusion)

    def seen_from(self, view: PosedView, camera: Camera) -> PosedView:
        """The same posed head before another camera: it is rasterised anew, and neither moved nor traced."""
        camera = camera.to(self.device)
        gbuffer = self.avatar.rasterize(view.motion, camera, edits=self.edits)
        return view._replace(camera=camera, gbuffer=gbuffer)

    def light(self, environment: Environment) -> SceneLight:
        """Filter an environment, once for all pictures."""
        environment = environment.to(self.device)
        return SceneLight(environment.filtered(), self.background.seen_of(environment))

    def relight(self, view: PosedView, light: SceneLight) -> Rendering:
        """Shade a view under a light, and put the background behind it."""
        behind = self.background.behind(view.camera, light.seen, rotate=light.filtered.rotate)
        return self.shade(view, light.filtered, behind)

    def behind(self, view: PosedView, environment: Environment) -> Tensor | float:
        """What is behind one view under an environment: display values (H, W, 3) or (3,), or a grey."""
        seen = self.background.seen_of(environment.to(self.device))
        return self.background.behind(view.camera, seen, rotate=environment.rotate)

    def shade(self, view: PosedView, light: FilteredLight, behind: Tensor | float) -> Rendering:
        """Shade a view and put display values behind it."""
        return self.avatar.shade(
            view.motion,
            view.gbuffer,
            view.camera,
            light,
            background=behind,
            occlusion=view.occlusion,
            tone_map=self.tone_map,
        )
