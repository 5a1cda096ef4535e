"""Pictures of a head by an independent ray caster: rays against its triangles.

Nothing is shared with the splatting. Camera rays meet the triangles; light comes from the sky, drawn by its
brightness and by the surface's lobes together, with shadow rays and two bounces. Diffuse light is what the
whole sky would give, which a table says exactly, times the share that the drawn directions leave of it. Every
pixel draws numbers of its own, so a picture has the same bits for any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from samira_subject.raycaster_kernels import trace_pixels
from samira_subject.raycaster_sampling import SkyTables
from samira_warp.geometry.camera import Camera
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.runtime import launch_range
from samira_warp.light.color import LUMINANCE

GRAIN = 64
"""Pixels that are worth a thread."""

AT_ONCE = 4096
"""Pixels that a thread is given at a time: Ctrl-C is heard in between, a fraction of a second apart."""

DARK = 0.05
"""Radiance that is added before a pixel's error is taken relative to it: in the dark, the eye and 8 bits ask
for less."""


@dataclass(frozen=True, eq=False)
class Skin:
    """What a head's surface is made of, in its UV layout; all on one device.

    Attributes:
        faces: (F, 3) int32 vertex ids.
        corner_uv: (F, 3, 2) float32 UV coordinates of the faces' corners.
        albedo: (S, S, 3) float32 linear diffuse reflectance.
        finish: (S, S, 3) float32 roughness, reflectance at normal incidence, and how much the surface
            scatters light below it.
        rest: (V, 3) float32 vertices that the slopes of bumps belong to, metres.
    """

    faces: Tensor
    corner_uv: Tensor
    albedo: Tensor
    finish: Tensor
    rest: Tensor


@dataclass(frozen=True)
class Effort:
    """How many rays a pixel gets.

    Attributes:
        samples: Camera rays of every pixel, at least 2: their spread tells the error.
        lights: Directions drawn by the sky's brightness, for each.
        lobes: Directions drawn from the surface's lobes, for each.
        more: Camera rays that a pixel gets on top in each round that finds it too noisy, and once where an
            outline crosses it.
        rounds: How often that is looked into.
        tolerance: Standard error, relative to the radiance, above which a pixel is too noisy.
    """

    samples: int = 4
    lights: int = 2
    lobes: int = 2
    more: int = 8
    rounds: int = 4
    tolerance: float = 0.09


class Picture(NamedTuple):
    """A head before nothing.

    Attributes:
        radiance: (H, W, 3) float32 linear, the mean over what a pixel holds of the head; 0 where that is
            nothing.
        specular: (H, W, 3) float32 linear, what of the radiance the surface mirrors, likewise.
        albedo: (H, W, 3) float32 linear diffuse reflectance, likewise.
        finish: (H, W, 3) float32 roughness, reflectance at normal incidence, and how much the surface
            scatters light below it, likewise.
        normal: (H, W, 3) float32 unit shading normals in world space, 0 where there is no head.
        coverage: (H, W) float32 share of the pixel.
        error: (H, W) float32 standard error of the radiance's luminance.
    """

    radiance: Tensor
    specular: Tensor
    albedo: Tensor
    finish: Tensor
    normal: Tensor
    coverage: Tensor
    error: Tensor


class PosedSkin:
    """A head in one pose, ready for rays."""

    def __init__(self, skin: Skin, vertices: Tensor, slopes: Tensor) -> None:
        """Build the mesh that rays meet.

        Args:
            skin: The surface.
            vertices: (V, 3) float32 in the world, metres.
            slopes: (S, S, 3) float32 gradient of the bumps' height over the rest head.
        """
        self._skin = skin
        # a mesh for each pose: several lights film it, and another pose may be taken before they have
        self._mesh = RayMesh(vertices, skin.faces)
        self._normals = vertex_normals(self._mesh.vertices, skin.faces)
        self._turns = _turns(skin.rest, self._mesh.vertices, skin.faces)
        self._slopes = slopes.contiguous()

    @torch.no_grad()
    def render(self, camera: Camera, sky: SkyTables, *, effort: Effort, seed: int) -> Picture:
        """Take a picture.

        Args:
            camera: The view.
            sky: The light, exposed.
            effort: How many rays.
            seed: Seed of every number drawn.
        """
        device, size = self._mesh.vertices.device, camera.width * camera.height
        light = torch.zeros(len(_Sums._fields) - 1, size, 3, device=device)
        sums = _Sums._make([*light, torch.zeros(size, dtype=torch.int32, device=device)])
        skin, mesh = self._skin, self._mesh
        head = (mesh.id, mesh.faces, mesh.vertices, self._normals, self._turns)
        maps = (skin.corner_uv, skin.albedo, skin.finish, self._slopes)
        view = _view(camera)

        def add(pixels: Tensor, begin: int, samples: int) -> None:
            numbers = (begin, samples, effort.lights, effort.lobes, seed)
            for some in pixels.split(AT_ONCE * torch.get_num_threads()):
                launch_range(
                    trace_pixels, len(some), some, *head, *maps, *sky, *view, *numbers, *sums, grain=GRAIN
                )

        everywhere = torch.arange(size, dtype=torch.int32, device=device)
        add(everywhere, 0, effort.samples)
        counts = torch.full((size,), float(effort.samples), device=device)
        is_hard = (sums.hits > 0) & (sums.hits < effort.samples) | sums.noisier_than(effort.tolerance, camera)
        for number in range(effort.rounds):
            add(everywhere[is_hard], effort.samples + number * effort.more, effort.more)
            counts = counts + effort.more * is_hard
            is_hard = is_hard & sums.noisier_than(effort.tolerance, camera)
        return sums.picture(counts, camera)


def _view(camera: Camera) -> tuple[object, ...]:
    """A camera as the kernels take it."""
    rotation = camera.world_to_camera[:3, :3].T.flatten().tolist()
    return (
        wp.mat33(*rotation),
        wp.vec3(*camera.center.tolist()),
        wp.vec2(camera.fx, camera.fy),
        wp.vec2(camera.cx, camera.cy),
        camera.width,
    )


class _Sums(NamedTuple):
    """Sums over the camera samples of each pixel that met the head, as `trace_pixels` adds them.

    Attributes:
        open: (P, 3) diffuse light as it were without shadows, exact for each sample.
        drawn: (P, 3) estimates of it.
        seen: (P, 3) what of the estimates comes from where the surface sees the sky.
        rest: (P, 3) all other light.
        specular: (P, 3) what of it is specular.
        products: (P, 3) squares and product of the luminance of ``seen + rest`` and of ``drawn - open``.
        albedo: (P, 3) diffuse reflectance.
        finish: (P, 3) roughness, reflectance and scattering.
        normal: (P, 3) shading normals.
        hits: (P,) int32 number of the samples.
    """

    open: Tensor
    drawn: Tensor
    seen: Tensor
    rest: Tensor
    specular: Tensor
    products: Tensor
    albedo: Tensor
    finish: Tensor
    normal: Tensor
    hits: Tensor

    def light(self) -> Tensor:
        """(P, 3) mean radiance.

        Diffuse light is the exact one without shadows times the share that shadow rays leave of it. Where no
        shadow falls nothing is left to chance (Heitz, Hill and McGuire, Combining Analytic Direct
        Illumination and Stochastic Shadows, 2018).
        """
        return (self.open * self._lit() + self.rest) / self._each()

    def error(self) -> Tensor:
        """(P,) standard error of the luminance, the ratio linearised.

        Samples that are stratified do better than it says. It is all of the light without shadows where no
        sample drew any of it.
        """
        each = self._each()[:, 0]
        lit = _luminance(self.seen) / _luminance(self.drawn).clamp(min=1e-12)
        found, excess = _luminance(self.seen + self.rest), _luminance(self.drawn - self.open)
        squares, mixed, excesses = self.products.unbind(dim=1)
        squared = squares - 2.0 * lit * mixed + lit**2 * excesses
        variance = (squared / each - ((found - lit * excess) / each) ** 2).clamp(min=0.0)
        spread = (variance / (self.hits - 1).clamp(min=1)).sqrt()
        unknown = (_luminance(self.drawn) == 0.0) & (_luminance(self.open) > 0.0)
        return torch.where(unknown, _luminance(self.open) / each, spread)

    def noisier_than(self, tolerance: float, camera: Camera) -> Tensor:
        """(P,) bool: whether the error is above a share of the radiance.

        `DARK` is added to the radiance: in the dark no eye sees the error. It is a pixel's own or, where that
        is larger, that of it and its neighbours together: a few samples that all missed a lamp do not know
        that they did.
        """
        is_head = (self.hits > 0).float()
        squares = torch.stack([is_head * self.error() ** 2, is_head]).view(2, camera.height, camera.width)
        error, count = torch.nn.functional.avg_pool2d(squares, 3, stride=1, padding=1).flatten(1)
        error = torch.maximum((error / count.clamp(min=1e-6)).sqrt(), self.error()) * is_head
        return error > tolerance * (_luminance(self.light()) + DARK)

    def picture(self, counts: Tensor, camera: Camera) -> Picture:
        """The picture, from the number of samples (P,) that each pixel was given."""
        shape, each = (camera.height, camera.width), self._each()
        return Picture(
            radiance=self.light().view(*shape, 3),
            specular=(self.specular / each).view(*shape, 3),
            albedo=(self.albedo / each).view(*shape, 3),
            finish=(self.finish / each).view(*shape, 3),
            normal=torch.nn.functional.normalize(self.normal, dim=1).view(*shape, 3),
            coverage=(self.hits / counts).view(shape),
            error=self.error().view(shape),
        )

    def _each(self) -> Tensor:
        return self.hits.clamp(min=1)[:, None]

    def _lit(self) -> Tensor:
        """(P, 3) share of the sky's light that no part of the head keeps off.

        All of it where nothing was drawn that lights the surface: there no ray has met a shadow.
        """
        return torch.where(self.drawn > 0.0, self.seen / self.drawn, 1.0)


def _luminance(light: Tensor) -> Tensor:
    return (light * light.new_tensor(LUMINANCE)).sum(dim=1)


def _turns(rest: Tensor, posed: Tensor, faces: Tensor) -> Tensor:
    """(F, 3, 3) rotations of the faces' frames from the rest head to the posed one."""
    return _frames(posed, faces) @ _frames(rest, faces).transpose(1, 2)


def _frames(vertices: Tensor, faces: Tensor) -> Tensor:
    a, b, c = vertices[faces.long()].unbind(dim=1)
    edge = torch.nn.functional.normalize(b - a, dim=1)
    normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    return torch.stack([edge, normal, torch.linalg.cross(edge, normal)], dim=2)
