"""From Gaussians to textures: what cameras round the head see of its surface, on the texels of an atlas.

A texel takes the weighted mean of what the views see at its place on the mesh, past the mesh itself: that is
blended as a picture is, with what is hidden left out. Texels that no view sees take what the nearest
Gaussians of the atlas carry, and those beyond its charts copy the nearest within, so that no filter and no
smaller level mixes in emptiness.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import grid_sample, normalize
from tqdm import tqdm

from samira_warp.avatar import Avatar, DrivingFrame, GBuffer, Motion
from samira_warp.export.mesh import SplitMesh, tangent_frames
from samira_warp.geometry.camera import Camera
from samira_warp.kernels.mesh.barycentric import closest_barycentrics
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.kernels.mesh.uv_raster import rasterize_uv
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.rays.visibility import visible
from samira_warp.stage.viewpoint import HeadPlace, Viewpoint, distance_to

POSES = 6
"""Frames that are looked at: the most neutral one, and others as different as can be, with lids closed and a
mouth open."""

BEFORE = tuple((yaw, pitch) for pitch in (-20, 20) for yaw in (-40, 0, 40))
"""Yaw and pitch, degrees, of the views of every frame."""

BESIDE = ((0, 0), (90, 0), (-90, 0), (135, 0), (-135, 0), (180, 0), (0, 75), (180, 45), (0, -50))
"""Those of the most neutral frame beside them: the backs of others are the same."""

PIXELS = 0.75
"""Of a view's longer side, by a texel of the map's: the face then has about as many of each."""

SHARPNESS = 4.0
"""Power of the cosine that weighs a view: one from the front has more to say than two from aside, where what
is not on the mesh itself is seen displaced."""

GRAZING = 0.2
"""Less than this cosine is not read: its pixels are mixed with what lies beside them."""

OPAQUE = 0.5
"""Pixels less covered than this are of wisps before the surface, or of none."""

SPREAD = 4.0
"""Texels that what was seen is carried over before Gaussians are asked: lines along edges of the mesh that
rays have missed, rims of what one sees."""

NEIGHBOURS = 6
"""Gaussians that a texel no view has seen is made of."""

WIDTHS = {"albedo": 3, "normal": 3, "roughness": 1, "specular": 1}
"""The channels that are baked, side by side, and how wide each is."""


class Textures(NamedTuple):
    """Maps of a head's surface, float32, row 0 at v = 1.

    Attributes:
        base_color: (H, W, 3) display values: the albedo as a picture.
        normal: (H, W, 3) unit, in the tangent frames of the mesh: along u, along v, outwards.
        roughness: (H, W) perceptual.
        specular: (H, W) reflectance at normal incidence.
        occlusion: (H, W) share of a uniform sky that the head at rest leaves open.
    """

    base_color: Tensor
    normal: Tensor
    roughness: Tensor
    specular: Tensor
    occlusion: Tensor


class Texels(NamedTuple):
    """The T texels of a map whose centres lie in a chart.

    Attributes:
        size: H = W.
        numbers: (T,) int64 theirs in the flattened map.
        corners: (T, 3) int64 ids of the split mesh's vertices about each.
        weights: (T, 3) float32 barycentric.
    """

    size: int
    numbers: Tensor
    corners: Tensor
    weights: Tensor

    @classmethod
    def of(cls, mesh: SplitMesh, *, size: int) -> Texels:
        """Those that a mesh covers."""
        raster = rasterize_uv(mesh.uv, mesh.faces, size=size)
        face = raster.face.flatten()
        index = (face >= 0).nonzero()[:, 0]
        return cls(size, index, mesh.faces[face[index].long()], raster.barycentrics.view(-1, 3)[index])

    def some(self, chosen: Tensor) -> Texels:
        """Those of them that a (T,) mask chooses."""
        return Texels(self.size, self.numbers[chosen], self.corners[chosen], self.weights[chosen])

    @property
    def places(self) -> Tensor:
        """(T, 2) u and v of their centres."""
        row, column = self.numbers // self.size, self.numbers % self.size
        return torch.stack([column + 0.5, self.size - row - 0.5], dim=1) / self.size

    def of_vertices(self, values: Tensor) -> Tensor:
        """(T, C) of (M, C) values of the split mesh's vertices."""
        return (self.weights[:, :, None] * values[self.corners]).sum(dim=1)

    def axes(self, vertices: Tensor, mesh: SplitMesh) -> Tensor:
        """(T, 3, 3) columns that a normal map's values are along, as renderers interpolate them."""
        frames = tangent_frames(vertices, mesh)
        columns = (frames.tangents, frames.bitangents, frames.normals)
        return torch.stack([normalize(self.of_vertices(column), dim=1) for column in columns], dim=2)

    def filled(self, values: Tensor, known: Tensor) -> Tensor:
        """(H, W, C) map of (T, C) values; all else copies the nearest of those (T,) that are known."""
        whole = values.new_zeros(self.size**2, values.shape[1])
        whole[self.numbers] = values
        row, column = distance_transform_edt(self._away(known), return_distances=False, return_indices=True)
        return whole[torch.from_numpy(row.astype(np.int64) * self.size + column)]

    def distances(self, known: Tensor) -> Tensor:
        """(T,) texels from each to the nearest of those that are known; infinite where none is."""
        if not bool(known.any()):
            return torch.full(known.shape, torch.inf)
        return torch.from_numpy(distance_transform_edt(self._away(known))).flatten()[self.numbers]

    def _away(self, known: Tensor) -> np.ndarray:
        """(H, W) bool, False at those of the (T,) texels that are known."""
        away = torch.ones(self.size**2, dtype=torch.bool)
        away[self.numbers] = ~known
        return away.view(self.size, self.size).numpy()


@torch.no_grad()
def bake(avatar: Avatar, frames: Sequence[DrivingFrame], mesh: SplitMesh, *, size: int) -> Textures:
    """Textures of an avatar.

    Args:
        avatar: On the CPU.
        frames: Its own, at least one.
        mesh: Its head, with UV coordinates that are one atlas.
        size: H = W, texels.
    """
    texels = Texels.of(mesh, size=size)
    looked_at = chosen_frames(frames, POSES)
    values, weights = _seen(avatar, looked_at, mesh, texels)
    seen = weights > 0.0
    values = values / weights.clamp(min=torch.finfo(values.dtype).tiny)[:, None]
    values = texels.filled(values, seen).flatten(0, 1)[texels.numbers]
    far = texels.distances(seen) > SPREAD
    values[far] = _carried(avatar, looked_at[0], mesh, texels.some(far))
    whole = texels.filled(values, torch.ones_like(seen))
    albedo, normal, roughness, specular = whole.split(tuple(WIDTHS.values()), dim=-1)
    return Textures(
        avatar.display(albedo),
        normalize(normal, dim=-1),
        roughness[..., 0],
        specular[..., 0],
        _openness(avatar, mesh, texels),
    )


def chosen_frames(frames: Sequence[DrivingFrame], count: int) -> list[DrivingFrame]:
    """The frame of least expression, then each time that whose expression is farthest from all before it.

    Of the training frames, where there are any: poses that the avatar has learned. Expressions are measured
    by how much each varies.
    """
    known = [frame for frame in frames if frame.part == "train"] or list(frames)
    poses = torch.stack(
        [torch.cat([f.parameters.expression, f.parameters.rotations[1:].flatten()]) for f in known]
    ).double()
    spread = poses.std(dim=0, correction=0)
    poses = torch.where(spread > 0.0, poses / spread.clamp(min=1e-6), 0.0)
    chosen = [int(poses.norm(dim=1).argmin())]
    away = (poses - poses[chosen[0]]).norm(dim=1)
    while len(chosen) < count and float(away.max()) > 0.0:
        chosen.append(int(away.argmax()))
        away = torch.minimum(away, (poses - poses[chosen[-1]]).norm(dim=1))
    return [known[index] for index in chosen]


def _seen(
    avatar: Avatar, frames: Sequence[DrivingFrame], mesh: SplitMesh, texels: Texels
) -> tuple[Tensor, Tensor]:
    """(T, C) weighted sums of the channels over all views, and (T,) of the weights; 0 where none sees."""
    lens = frames[0].camera.with_longer_side(round(PIXELS * texels.size))
    rays = RayMesh(avatar.canonical.vertices, avatar.canonical.topology.faces)
    total, weights = torch.zeros(len(texels.numbers), sum(WIDTHS.values())), torch.zeros(len(texels.numbers))
    views = [(frame, BEFORE + (BESIDE if number == 0 else ())) for number, frame in enumerate(frames)]
    with tqdm(total=sum(len(places) for _, places in views), unit="view", dynamic_ncols=True) as progress:
        for frame, places in views:
            motion = avatar.move(frame.parameters)
            surface = _SurfaceAt.of(motion, mesh, texels, rays)
            place = HeadPlace.of(avatar.canonical, motion.head)
            distance = distance_to(frame.camera, place)
            for yaw, pitch in places:
                camera = Viewpoint(yaw, pitch, distance).camera(place, lens)
                ids, values, weight = surface.read(avatar.rasterize(motion, camera), camera)
                total[ids] += weight[:, None] * values
                weights[ids] += weight
                progress.update()
    return total, weights


class _SurfaceAt(NamedTuple):
    """The texels' places in one pose.

    Attributes:
        points: (T, 3) metres.
        normals: (T, 3) unit, the mesh's own.
        to_tangent: (T, 3, 3) from the world to the tangent frames.
        rays: The mesh in this pose.
    """

    points: Tensor
    normals: Tensor
    to_tangent: Tensor
    rays: RayMesh

    @classmethod
    def of(cls, motion: Motion, mesh: SplitMesh, texels: Texels, rays: RayMesh) -> _SurfaceAt:
        """Move the mesh, and with it the texels."""
        vertices = motion.head.vertices
        rays.refit(vertices)
        axes = texels.axes(vertices, mesh)
        return cls(
            texels.of_vertices(vertices[mesh.source]), axes[:, :, 2], torch.linalg.inv_ex(axes).inverse, rays
        )

    def read(self, gbuffer: GBuffer, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
        """(R,) the texels that a view sees, (R, C) their channels and (R,) weights."""
        cosine = (self.normals * normalize(camera.center - self.points, dim=1)).sum(dim=1)
        ids = (cosine > GRAZING).nonzero()[:, 0]
        ids = ids[visible(self.points[ids], self.rays, origin=camera.center)]
        pixel = camera.image_points(self.points[ids])[:, :2]
        grid = (2.0 * pixel / pixel.new_tensor([camera.width, camera.height]) - 1.0)[None, None]
        # straight values are 0 beyond the head: beside its rim they are averaged by their coverage
        straight = torch.cat([getattr(gbuffer, name) for name in WIDTHS], dim=-1)
        picture = torch.cat([straight * gbuffer.alpha, gbuffer.alpha], dim=-1)
        sampled = grid_sample(picture.permute(2, 0, 1)[None], grid, align_corners=False)[0, :, 0].T
        covered = sampled[:, -1] > OPAQUE
        ids, sampled = ids[covered], sampled[covered]
        alpha = sampled[:, -1:]
        albedo, normal, *rest = (sampled[:, :-1] / alpha).split(tuple(WIDTHS.values()), dim=1)
        normal = normalize((self.to_tangent[ids] @ normal[..., None])[..., 0], dim=1)
        return ids, torch.cat([albedo, normal, *rest], dim=1), alpha[:, 0] * cosine[ids] ** SHARPNESS


def _carried(avatar: Avatar, frame: DrivingFrame, mesh: SplitMesh, texels: Texels) -> Tensor:
    """(T, C) what the nearest Gaussians of the atlas carry, by opacity and a bell as wide as they lie."""
    gaussians, motion = avatar.gaussians, avatar.move(frame.parameters)
    distance, near = cKDTree(_atlas_places(avatar, mesh).numpy()).query(
        texels.places.numpy(), k=range(1, min(NEIGHBOURS, len(gaussians)) + 1)
    )
    reach = torch.from_numpy(distance).float()
    bell = torch.exp(-2.0 * (reach / reach[:, -1:].clamp(min=1e-9)).square())
    weights = gaussians.opacities[near] * bell
    weights = weights / weights.sum(dim=1, keepdim=True).clamp(min=1e-12)
    surface = avatar.surface(motion)
    channels = torch.cat([getattr(surface, name) for name in WIDTHS], dim=1)
    albedo, normal, *rest = (
        (weights[..., None] * channels[near]).sum(dim=1).split(tuple(WIDTHS.values()), dim=1)
    )
    to_tangent = torch.linalg.inv_ex(texels.axes(motion.head.vertices, mesh)).inverse
    normal = normalize((to_tangent @ normal[..., None])[..., 0], dim=1)
    return torch.cat([albedo, normal, *rest], dim=1)


def _atlas_places(avatar: Avatar, mesh: SplitMesh) -> Tensor:
    """(N, 2) where each Gaussian's nearest point of its face lies in the mesh's atlas."""
    gaussians, canonical = avatar.gaussians, avatar.canonical
    frames, faces = triangle_frames(canonical.vertices, canonical.topology), gaussians.faces.long()
    turned = (frames.rotation[faces] @ gaussians.means[..., None])[..., 0]
    points = frames.scale[faces, None] * turned + frames.translation[faces]
    triangles = canonical.vertices[mesh.head_faces[faces]]
    weights = closest_barycentrics(points.contiguous(), triangles.contiguous())
    return (weights[:, :, None] * mesh.uv[mesh.faces[faces]]).sum(dim=1)


def _openness(avatar: Avatar, mesh: SplitMesh, texels: Texels) -> Tensor:
    """(H, W) openness of the head at rest to a uniform sky."""
    canonical = avatar.canonical
    open_share = avatar.occluder.occlude(canonical.pose(canonical.rig.rest())).openness
    at_texels = texels.of_vertices(open_share[mesh.source])
    return texels.filled(at_texels, torch.ones(len(at_texels), dtype=torch.bool))[..., 0]
