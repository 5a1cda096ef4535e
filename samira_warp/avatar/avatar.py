"""The avatar: one head's Gaussians, motion, materials and light, and the way to an image."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

from samira_warp.avatar.canonical import CanonicalHead
from samira_warp.avatar.editing import MaterialEdit, edit_materials
from samira_warp.avatar.gaussians import Gaussians
from samira_warp.avatar.gbuffer import GBuffer, blend_arrival, light_channels, render_gbuffer
from samira_warp.avatar.occlusion import Occluder, Occlusion, gaussian_arrival
from samira_warp.avatar.picture import shade_picture
from samira_warp.avatar.portrait import Portraits, png_of
from samira_warp.avatar.residual import LimitedResidual, limit_residual
from samira_warp.avatar.response import response_factors, response_map
from samira_warp.avatar.settings import AvatarSettings
from samira_warp.avatar.storage import find_avatar, naming_misfits, read_avatar, write_avatar
from samira_warp.avatar.uv_sampling import corner_table
from samira_warp.avatar.wrinkles import face_tangents, wrinkled
from samira_warp.geometry.camera import Camera
from samira_warp.head import REGIONS, FrameParameters, PosedHead, UvAtlas
from samira_warp.kernels.gathering.gather import GatherTable, bilinear_table, gather
from samira_warp.kernels.mesh.binding import BoundGaussians, FaceBinding, bind
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames, triangle_frames
from samira_warp.kernels.mesh.turning import turn
from samira_warp.light import (
    ColorSpace,
    Environment,
    FilteredLight,
    LearnableLight,
    Shaded,
    shade,
    to_display,
)
from samira_warp.nets import Conditions, ConditionStatistics, MotionNetwork
from samira_warp.nets.motion import RESIDUAL_CHANNELS
from samira_warp.support.errors import UserError
from samira_warp.support.tone_names import ToneMap
from samira_warp.support.unchanged import WhileUnchanged
from samira_warp.surface import Surface

DISPLACEMENT_UNIT = 0.01
"""Metres; expressions move the skin by a few millimetres, so D_uv in this unit is about one."""


class Motion(NamedTuple):
    """One frame's Gaussians in world space, and what moved them.

    Attributes:
        head: The posed mesh M_t.
        gaussians: Means, quaternions and scales after the residual; normals before it (Eq. normal_transform),
            but for wrinkles.
        residual: (H, W, C) UV map of what the motion network says, before its limits: o_mu and o_r, then the
            wrinkles' slopes where there are any; zero without a residual.
        normals: (N, 3) canonical normals, of any length, as wrinkles have turned them.
    """

    head: PosedHead
    gaussians: BoundGaussians
    residual: torch.Tensor
    normals: torch.Tensor

    # maps that most pictures do not need are made when they are asked for

    @property
    def limited(self) -> LimitedResidual:
        """UV maps (H, W, 3), (H, W, 3) and (H, W, 2) of the residual within its limits; zero without it."""
        limited = limit_residual(self.residual)
        if self.residual.shape[-1] == RESIDUAL_CHANNELS:
            return limited._replace(slopes=torch.zeros_like(self.residual[..., :2]))
        return limited

    @property
    def residual_position(self) -> torch.Tensor:
        """(H, W, 3) UV map, metres; zero without a residual."""
        return self.limited.position

    @property
    def residual_rotation(self) -> torch.Tensor:
        """(H, W, 3) UV map, axis-angle radians."""
        return self.limited.rotation

    @property
    def slopes(self) -> torch.Tensor:
        """(H, W, 2) UV map of the wrinkles that turn the normals, along u and v; zero without them."""
        return self.limited.slopes


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered frame.

    Attributes:
        image: (H, W, 3) display values.
        gbuffer: Surface attributes behind it.
        radiance: (H, W, 3) C_fg of the head alone, linear, not premultiplied; 0 where there is none.
        irradiance: (H, W, 3) L_d, linear.
        specular_light: (H, W, 3) L_s, linear.
        motion: The Gaussians behind the G-buffer.
        color_space: What the shading behind ``image`` worked in.
        tone_map: What brought it into the range of a display.
    """

    image: torch.Tensor
    gbuffer: GBuffer
    radiance: torch.Tensor
    irradiance: torch.Tensor
    specular_light: torch.Tensor
    motion: Motion
    color_space: ColorSpace
    tone_map: ToneMap = "none"

    @property
    def foreground(self) -> torch.Tensor:
        """(H, W, 3) display values of the head alone, not premultiplied: without any background."""
        return to_display(self.radiance, color_space=self.color_space, tone_map=self.tone_map)

    @property
    def albedo(self) -> torch.Tensor:
        """(H, W, 3) display values of the G-buffer's albedo."""
        return to_display(self.gbuffer.albedo, color_space=self.color_space)

    def _repr_png_(self) -> bytes:
        """The image, where a notebook shows it."""
        return png_of(self.image)


class Avatar(nn.Module):
    """A relightable, animatable head: head parameters, a camera and a light in, an image out.

    Attributes:
        canonical: The subject's head at rest.
        settings: What the avatar is made of.
        gaussians: The mesh-bound Gaussians; replace them with `set_gaussians`.
        motion: The semantic-adaptive motion network.
        statistics: Mean and deviation of the training frames' conditions.
        response_logits: (K, 2) l_k of Eq. region_response.
        light: The learned capture light.
    """

    def __init__(
        self,
        canonical: CanonicalHead,
        settings: AvatarSettings,
        *,
        gaussians: Gaussians,
        image_features: list[torch.Tensor],
        statistics: ConditionStatistics,
        light: LearnableLight,
    ) -> None:
        super().__init__()
        self.canonical, self.settings = canonical, settings
        self.motion = MotionNetwork(
            settings.motion,
            reference_positions=_to_unit_cube(canonical.positions, canonical.atlas.valid).permute(2, 0, 1),
            image_features=image_features,
            masks=_one_hot_masks(canonical.atlas),
            expression_size=canonical.template.n_expression,
            pose_size=canonical.rig.pose_size,
        )
        self.statistics = statistics
        self.response_logits = nn.Parameter(torch.zeros(len(REGIONS), 2))
        self.light = light
        self.occluder = Occluder(canonical.vertices, canonical.topology)
        self._portraits = Portraits()
        self._kept_responses: WhileUnchanged[dict[str, torch.Tensor]] = WhileUnchanged()
        self.set_gaussians(gaussians)

    def set_gaussians(self, gaussians: Gaussians) -> None:
        """Replace the Gaussians and rebuild the tables that depend on their faces and UV coordinates."""
        self.gaussians = gaussians
        size = self.settings.uv_size
        self.binding = FaceBinding.build(gaussians.faces, len(self.canonical.topology.faces))
        self.uv_samples: GatherTable = bilinear_table(gaussians.uv, width=size, height=size)
        tangents = face_tangents(self.canonical.vertices, self.canonical.topology, self.canonical.atlas)
        self.tangents = tangents[gaussians.faces.long()]
        self.corners = corner_table(
            gaussians.uv, gaussians.faces, topology=self.canonical.topology, atlas=self.canonical.atlas
        )

    def _apply(self, function: Callable[[torch.Tensor], torch.Tensor], recurse: bool = True) -> Avatar:
        """Move the constant tables along with the parameters (torch's hook behind ``to``)."""
        super()._apply(function, recurse)
        self.canonical = self.canonical.to(self.gaussians.means.device)
        self.occluder = Occluder(self.canonical.vertices, self.canonical.topology)
        self.set_gaussians(self.gaussians)
        return self

    def move(self, parameters: FrameParameters, *, seen: FrameParameters | None = None) -> Motion:
        """Mesh binding (Eq. lbs) refined by the residual (Eqs. uv_displacement to final_motion).

        Args:
            parameters: What poses the mesh.
            seen: What the motion network sees of the frame instead of that, in training.
        """
        head = self.canonical.pose(parameters)
        frames = triangle_frames(head.vertices, self.canonical.topology)
        normals: torch.Tensor = self.gaussians.normals
        if not self.settings.residual:
            nothing = normals.new_zeros(*self.canonical.positions.shape[:2], RESIDUAL_CHANNELS)
            return Motion(head, self._bound(frames, normals), nothing, normals)
        if seen is None:
            residual = self._residual(head, parameters)
        else:
            residual = self._residual(self.canonical.pose(seen), seen)
        sampled = gather(residual.reshape(-1, residual.shape[-1]), self.uv_samples)
        position, rotation, slopes = limit_residual(sampled)
        if self.settings.motion.wrinkles:
            normals = wrinkled(normals, slopes, self.tangents)
        bound = self._bound(frames, normals)
        if self.settings.residual_frame == "head":
            axes = head.head_transform[:3, :3].T
            position, rotation = position @ axes, rotation @ axes
        refined = bound._replace(means=bound.means + position, quaternions=turn(bound.quaternions, rotation))
        return Motion(head, refined, residual, normals)

    def _residual(self, head: PosedHead, parameters: FrameParameters) -> torch.Tensor:
        """(H, W, C) what the network says of a frame, before limits (Eqs. uv_displacement to dynamic_map).

        Position and rotation come first, then the wrinkles' slopes.
        """
        in_head = self.settings.displacement_frame == "head"
        displacement = self.canonical.displacement(head, in_head=in_head) / DISPLACEMENT_UNIT
        residual = self.motion(displacement.permute(2, 0, 1), self.statistics(conditions_of(parameters)))
        return self.canonical.atlas.dilate(residual.permute(1, 2, 0))

    def _bound(self, frames: TriangleFrames, normals: torch.Tensor) -> BoundGaussians:
        """The Gaussians on their triangles, smoothed, with (N, 3) canonical normals."""
        g = self.gaussians
        bound = bind(g.means, g.quaternions, g.scales, normals, self.binding, frames)
        # variances add, and those of an isotropic filter do along any axes
        return bound._replace(scales=(bound.scales.square() + self.settings.smoothing**2).sqrt())

    def surface(
        self,
        motion: Motion,
        *,
        edits: Sequence[MaterialEdit] = (),
        arrival: torch.Tensor | None = None,
    ) -> Surface:
        """Every channel of every Gaussian, in world space, the materials changed by ``edits``.

        Channels of light are those of ``arrival`` (`Avatar.arrival`), or neutral.
        """
        g = self.gaussians
        responses = self._responses() if self.settings.response else {}
        surface = Surface.of(
            albedo=g.albedo,
            normal=motion.gaussians.normals,
            roughness=g.roughness[:, None],
            specular=g.specular[:, None],
            **responses,
            **({} if arrival is None else light_channels(arrival)),
        )
        if not edits:
            return surface
        return edit_materials(surface, edits, self.region_weights(), color_space=self.settings.color_space)

    def _responses(self) -> dict[str, torch.Tensor]:
        """The response factors tau^d and tau^s of every Gaussian, (N, 1) each, by channel."""
        if torch.is_grad_enabled():
            return self._respond()
        samples = self.uv_samples
        of = (self.response_logits, self.canonical.atlas.soft_masks, samples.indices, samples.weights)
        return self._kept_responses.get(of, self._respond)

    def _respond(self) -> dict[str, torch.Tensor]:
        factors = response_map(response_factors(self.response_logits), self.canonical.atlas.soft_masks)
        diffuse, specular = gather(factors.reshape(-1, 2), self.uv_samples).split(1, dim=1)
        return {"response_diffuse": diffuse, "response_specular": specular}

    def region_weights(self) -> torch.Tensor:
        """(N, K) shares of the regions in each Gaussian.

        They sum to 1 where its surface is in some mask of the template, else to 0.
        """
        soft_masks = self.canonical.atlas.soft_masks
        return gather(soft_masks.flatten(1).T.contiguous(), self.uv_samples)

    def rasterize(
        self,
        motion: Motion,
        camera: Camera,
        *,
        edits: Sequence[MaterialEdit] = (),
        arrival: torch.Tensor | None = None,
    ) -> GBuffer:
        """The G-buffer of moved Gaussians.

        Args:
            motion: The Gaussians.
            camera: The view.
            edits: Changes to the materials.
            arrival: What of a light arrives at them (`Avatar.arrival`), where it is known by now; else
                `Avatar.shade` may still blend it in.
        """
        moved = motion.gaussians
        surface = self.surface(motion, edits=edits, arrival=arrival)
        geometry = (moved.means, moved.quaternions, moved.scales, self.gaussians.opacities)
        return render_gbuffer(*geometry, surface, camera, lit=arrival is not None)

    def render(
        self,
        parameters: FrameParameters,
        camera: Camera,
        environment: Environment | FilteredLight | None = None,
        *,
        background: torch.Tensor | float = 1.0,
        edits: Sequence[MaterialEdit] = (),
        shadows: bool = True,
        tone_map: ToneMap = "none",
    ) -> Rendering:
        """Render one frame.

        Args:
            parameters: The head's pose and expression, on any device.
            camera: The view, on any device.
            environment: The light as it is turned and exposed, on any device; None is the learned capture
                light. To reuse an environment, filter it once (`Environment.filtered`).
            background: Display values behind the head: a number, or float32 (3,) or (H, W, 3) on any device,
                such as `Environment.background`.
            edits: Changes to the materials, applied in their order.
            shadows: Let the head block the light. An avatar that learned its light without shadows, and
                painted them into the rest, casts none under that light.
            tone_map: "filmic" keeps what is brighter than a display's white from being clipped; for an avatar
                whose shading works in linear light.

        Raises:
            UserError: The background is of another shape or dtype, or a tone map is asked for image values.
        """
        device = self.gaussians.means.device
        camera = camera.to(device)
        motion = self.move(parameters.to(device))
        light = self.light() if environment is None else environment.to(device)
        if isinstance(light, Environment):
            light = light.filtered()
        if isinstance(background, torch.Tensor):
            background = background.to(device)
        casts = shadows and (self.settings.visibility or environment is not None)
        arrival = self.arrival(self.occluder.occlude(motion.head), light, camera) if casts else None
        gbuffer = self.rasterize(motion, camera, edits=edits, arrival=arrival)
        return self.shade(motion, gbuffer, camera, light, background=background, tone_map=tone_map)

    def shade(
        self,
        motion: Motion,
        gbuffer: GBuffer,
        camera: Camera,
        light: FilteredLight,
        *,
        background: torch.Tensor | float = 1.0,
        occlusion: Occlusion | None = None,
        tone_map: ToneMap = "none",
    ) -> Rendering:
        """Deferred shading and compositing of a G-buffer (Eqs. response_shading to alpha_compose).

        Arguments as for `render`, but on the avatar's device; ``occlusion`` is that of the motion's head
        (`Avatar.occluder`), for a G-buffer that was made without what arrives of this light.

        Raises:
            UserError: The background is of another shape or dtype, or on another device, or a tone map is
                asked for image values.
        """
        if occlusion is not None:
            gbuffer = blend_arrival(gbuffer, self.arrival(occlusion, light, camera))
        color_space = self.settings.color_space
        shaded = _shade_pixels(
            gbuffer, camera, light, background=background, color_space=color_space, tone_map=tone_map
        )
        return Rendering(
            shaded.image,
            gbuffer,
            shaded.color,
            shaded.irradiance,
            shaded.specular_light,
            motion,
            color_space,
            tone_map,
        )

    def arrival(self, occlusion: Occlusion, light: FilteredLight, camera: Camera) -> torch.Tensor:
        """What of a light arrives at every Gaussian: the channels of light, (N, 5), side by side.

        Differentiable in the light alone.
        """
        return self.arrival_from(self.occluder.arrival(occlusion, light, camera))

    def arrival_from(self, at_vertices: torch.Tensor) -> torch.Tensor:
        """The same from what arrives at the vertices, (V, 6) of `Occluder.arrival`."""
        at_gaussians = gather(at_vertices, self.corners)
        return gaussian_arrival(at_gaussians, self.gaussians.roughness.detach()[:, None])

    def display(self, values: torch.Tensor) -> torch.Tensor:
        """Albedo or radiance as a picture.

        sRGB-encoded where shading is linear, as it is where shading works in image values.
        """
        return to_display(values, color_space=self.settings.color_space)

    def _repr_png_(self) -> bytes:
        """The face at rest under the learned light, where a notebook shows the avatar."""
        return png_of(self._portraits.draw(self))

    def load_state_dict(
        self, state_dict: Mapping[str, Any], strict: bool = True, assign: bool = False
    ) -> Any:
        """Take another avatar's state, and rebuild the tables that depend on its Gaussians' faces and UVs.

        Raises:
            UserError: It has another number of Gaussians; nothing is taken then. `set_gaussians` changes the
                number, `load` makes an avatar of a folder's own.
        """
        means = state_dict.get("gaussians.means")
        if means is not None and len(means) != len(self.gaussians):
            raise UserError(
                "state_dict", expected=f"the {len(self.gaussians)} Gaussians of this avatar", found=len(means)
            )
        result = super().load_state_dict(state_dict, strict=strict, assign=assign)
        self.set_gaussians(self.gaussians)
        return result

    def save(self, folder: Path, *, record: dict[str, Any]) -> None:
        """Write the avatar's files into an existing folder.

        All that rendering needs, no pickle, and its learned light as two maps.

        Args:
            folder: Where.
            record: How it was made, as plain JSON values.
        """
        write_avatar(
            folder,
            canonical=self.canonical,
            settings=self.settings,
            state=self.state_dict(),
            light=self.light.environment(),
            record=record,
        )

    @classmethod
    def load(cls, path: str | Path, *, device: torch.device | str = "cpu") -> Avatar:
        """Load an avatar from its folder, or from the run folder that it is in.

        Raises:
            UserError: A file is missing, broken, or of an unknown version.
        """
        folder = find_avatar(Path(path))
        with naming_misfits(folder):
            stored = read_avatar(folder)
            avatar = cls(
                stored.canonical,
                stored.settings,
                gaussians=stored.gaussians,
                image_features=stored.image_features,
                statistics=stored.statistics,
                light=stored.light,
            )
            avatar.load_state_dict(stored.state)
        return avatar.to(device)


def conditions_of(parameters: FrameParameters) -> Conditions:
    """The network's conditions of one frame or a batch, as they came."""
    return Conditions(parameters.translation, parameters.expression, parameters.rotations.flatten(-2))


def _shade_pixels(
    gbuffer: GBuffer,
    camera: Camera,
    light: FilteredLight,
    *,
    background: torch.Tensor | float,
    color_space: ColorSpace,
    tone_map: ToneMap,
) -> Shaded:
    """Shade and compose every pixel of a G-buffer; the maps of the result are (H, W, 3)."""
    surface, alpha = gbuffer.map(lambda values: values.flatten(0, 1)), gbuffer.alpha.flatten(0, 1)
    behind, size = _behind(background, gbuffer.albedo), gbuffer.alpha.shape[:2]
    if torch.is_grad_enabled():
        toward = -camera.ray_directions().flatten(0, 1)
        shaded = shade(
            surface,
            toward,
            light,
            alpha=alpha,
            background=behind,
            color_space=color_space,
            tone_map=tone_map,
        )
    else:
        shaded = shade_picture(
            surface,
            camera,
            light,
            alpha=alpha,
            background=behind,
            color_space=color_space,
            tone_map=tone_map,
        )
    return Shaded(*(value.unflatten(0, size) for value in shaded))


def _behind(background: torch.Tensor | float, image: torch.Tensor) -> torch.Tensor | float:
    """A background for the pixels of an image (H, W, 3), as `shade` takes it for points."""
    if isinstance(background, Real):
        return float(background)
    found = type(background).__name__
    if isinstance(background, torch.Tensor):
        fits = background.shape in ((3,), image.shape)
        if fits and (background.dtype, background.device) == (image.dtype, image.device):
            return background.reshape(-1, 3)
        found = f"{background.dtype} {tuple(background.shape)} on {background.device}".removeprefix("torch.")
    raise UserError(
        "background",
        expected=f"a number, or float32 (3,) or {tuple(image.shape)} on {image.device}",
        found=found,
    )


def _to_unit_cube(positions: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Scale an (H, W, 3) position map so that its (H, W) valid texels fill [-1, 1] about their centre.

    The others become 0.
    """
    low, high = positions[valid].amin(dim=0), positions[valid].amax(dim=0)
    return valid[..., None] * (2.0 * (positions - 0.5 * (low + high)) / (high - low).max())


def _one_hot_masks(atlas: UvAtlas) -> torch.Tensor:
    """(K, H, W) disjoint routing masks of 0 and 1."""
    regions = torch.arange(len(REGIONS), device=atlas.region.device)
    return (atlas.region[None] == regions[:, None, None]).float()
