"""Everything that is decided before the first step: reference frame, textures, Gaussians and statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from samira_warp.avatar import CanonicalHead, Gaussians, conditions_of, geometry_uv
from samira_warp.data import Frame, PixelCache, TrackedSequence
from samira_warp.geometry.mesh import face_areas, vertex_normals
from samira_warp.head.unwrap import UnwrapView, unwrap
from samira_warp.kernels.gathering.gather import bilinear_table, gather
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.nets import ConditionStatistics
from samira_warp.train.materials import EYEBALLS, material_prior

DENSE_GROUPS = ("left_eye_region", "right_eye_region", "lips")
DENSE_FACTOR = 3.0
"""Expression happens at eyes and lips: they get three times the Gaussians per area."""

SPARSE_FACTOR = 0.5
"""Most of an eyeball is never seen."""

IRIS_FACTOR = 8.0
IRIS_DEGREES = 40.0
"""About an eyeball's axis, forwards: the iris (30 degrees) and its edge, round, and looked at more closely
than anything else."""

SIZE_IN_SPACINGS = 0.75
"""Initial standard deviation along the surface, in spacings: neighbours overlap enough to leave no holes."""

FLATNESS = 0.2
"""Initial standard deviation along the normal, as a share of that along the surface."""

FRONTAL_DEGREES = 10.0
"""In the choice of the reference frame, this many degrees off the frontal pose weigh as much as one standard
deviation of expression."""

ALBEDO_VIEWS = 12
"""Frames that the initial albedo is unwrapped from, evenly spaced over the training frames."""


def condition_statistics(sequence: TrackedSequence) -> ConditionStatistics:
    """Statistics of the training frames' conditions; test frames are not looked at."""
    return ConditionStatistics.of(conditions_of(sequence.batch(sequence.train)))


@torch.no_grad()
def choose_reference(
    sequence: TrackedSequence, canonical: CanonicalHead, statistics: ConditionStatistics
) -> int:
    """Index of the training frame nearest to mean expression and frontal pose."""

    def score(index: int) -> float:
        frame = sequence.frames[index]
        expression = statistics(conditions_of(frame.parameters)).expression
        facing = canonical.pose(frame.parameters).head_transform[:3, :3]
        forward = facing @ canonical.vertices.new_tensor([0.0, 0.0, 1.0])
        backwards = -frame.camera.world_to_camera[2, :3]
        angle = torch.rad2deg(torch.acos((forward @ backwards).clamp(-1.0, 1.0)))
        return float(expression.square().mean().sqrt() + angle / FRONTAL_DEGREES)

    return min(sequence.train, key=score)


def image_view(
    sequence: TrackedSequence, pixels: PixelCache, canonical: CanonicalHead, index: int
) -> UnwrapView:
    """One frame's image as it is unwrapped."""
    content = pixels[index]
    return _view(sequence.frames[index], canonical, content.image, content.mask)


def albedo_view(
    sequence: TrackedSequence, pixels: PixelCache, canonical: CanonicalHead, index: int
) -> UnwrapView | None:
    """One frame's pseudo-albedo as it is unwrapped; None where it has none."""
    content = pixels[index]
    if content.albedo is None:
        return None
    return _view(sequence.frames[index], canonical, content.albedo, content.mask)


@torch.no_grad()
def _view(frame: Frame, canonical: CanonicalHead, image: torch.Tensor, mask: torch.Tensor) -> UnwrapView:
    height, width = mask.shape
    vertices = canonical.pose(frame.parameters).vertices
    return UnwrapView(image, mask, vertices, frame.camera.resized(width=width, height=height))


@torch.no_grad()
def sampling_interval(sequence: TrackedSequence, canonical: CanonicalHead, *, resolution: int) -> float:
    """Metres between the points of a head that neighbouring pixels of the finest training picture see.

    Args:
        sequence: The dataset, of which some frames are looked at, evenly spaced.
        canonical: The subject's head.
        resolution: Longer side of the training pictures, pixels.
    """

    def interval(frame: Frame) -> float:
        camera = frame.camera.with_longer_side(resolution)
        return canonical.sampling_interval(frame.parameters, camera)

    return min(interval(sequence.frames[index]) for index in spread_out(sequence.train))


def unwrap_views(views: list[UnwrapView], canonical: CanonicalHead) -> torch.Tensor:
    """(h, w, C) what views see of a subject, on its atlas: see `unwrap`."""
    return unwrap(views, atlas=canonical.atlas, vertices=canonical.vertices, faces=canonical.topology.faces)


def initial_albedo(
    sequence: TrackedSequence, pixels: PixelCache, canonical: CanonicalHead, reference: torch.Tensor
) -> torch.Tensor:
    """(h, w, 3) display-valued albedo texture.

    Unwrapped pseudo-albedo where the dataset has any, else the reference image.
    """
    with_albedo = [index for index in sequence.train if sequence.frames[index].albedo_path]
    views = [albedo_view(sequence, pixels, canonical, index) for index in spread_out(with_albedo)]
    found = [view for view in views if view is not None]
    return unwrap_views(found, canonical) if found else reference


def spread_out(indices: Sequence[int], most: int = ALBEDO_VIEWS) -> list[int]:
    """So many of some frames, evenly spaced; all of them where they are fewer."""
    count = min(most, len(indices))
    return [indices[place * len(indices) // count] for place in range(count)]


@torch.no_grad()
def initial_gaussians(
    canonical: CanonicalHead,
    *,
    count: int,
    opacity: float,
    albedo: torch.Tensor,
    smooth_normals: bool,
    generator: torch.Generator,
) -> Gaussians:
    """Sample Gaussians over the reference mesh by area, denser at eyes and lips.

    Args:
        canonical: The subject's head.
        count: N.
        opacity: Initial opacity of all.
        albedo: (h, w, 3) linear albedo texture.
        smooth_normals: Start from interpolated vertex normals; False starts from the face's own.
        generator: Draws the positions.
    """
    vertices, faces = canonical.vertices, canonical.topology.faces.long()
    areas = face_areas(vertices, faces)
    density = _densities(canonical, count)
    face_ids = _systematic_sample(areas * density, count, generator)
    barycentrics = _uniform_barycentrics(count, generator).to(vertices.device)
    frames = triangle_frames(vertices, canonical.topology)
    rotation, scale = frames.rotation[face_ids], frames.scale[face_ids]
    points = torch.einsum("nk,nkc->nc", barycentrics, vertices[faces[face_ids]])
    means = torch.einsum("nji,nj->ni", rotation, points - frames.translation[face_ids]) / scale[:, None]
    spread = initial_spread(canonical, count)[face_ids] / scale
    scales = torch.stack([spread, FLATNESS * spread, spread], dim=1)
    world_normals = torch.einsum("nk,nkc->nc", barycentrics, vertex_normals(vertices, faces)[faces[face_ids]])
    normals = torch.nn.functional.normalize(torch.einsum("nji,nj->ni", rotation, world_normals), dim=1)
    if not smooth_normals:
        normals = torch.zeros_like(normals)
        normals[:, 1] = 1.0
    ids, materials = face_ids.to(torch.int32), material_prior(canonical.template)
    uv = geometry_uv(means, ids, vertices=vertices, topology=canonical.topology, atlas=canonical.atlas)
    size = canonical.atlas.size
    colors = gather(albedo.flatten(0, 1).contiguous(), bilinear_table(uv, width=size, height=size))
    return Gaussians.start(
        means=means,
        scales=scales,
        normals=normals,
        albedo=colors,
        roughness=materials.roughness.to(means.device)[face_ids],
        specular=materials.specular.to(means.device)[face_ids],
        faces=ids,
        uv=uv,
        opacity=opacity,
    )


def initial_spread(canonical: CanonicalHead, count: int) -> torch.Tensor:
    """(F,) metres: standard deviation along the surface that `count` Gaussians start with on each face."""
    return SIZE_IN_SPACINGS * _densities(canonical, count).rsqrt()


def _densities(canonical: CanonicalHead, count: int) -> torch.Tensor:
    """(F,) how many of `count` Gaussians start on a square metre of each face."""
    factors = _density_factors(canonical)
    areas = face_areas(canonical.vertices, canonical.topology.faces.long())
    return factors * count / (areas * factors).sum()


def _density_factors(canonical: CanonicalHead) -> torch.Tensor:
    """(F,) relative density: a face counts as in a group, or an iris, when at least two of its corners do."""
    factors = torch.ones(len(canonical.vertices), device=canonical.vertices.device)
    groups = {
        name: torch.from_numpy(members).to(factors.device).long()
        for name, members in canonical.template.masks.items()
        if name in (*DENSE_GROUPS, *EYEBALLS)
    }
    for name in DENSE_GROUPS:
        factors[groups.get(name, [])] = DENSE_FACTOR
    for name in groups.keys() - set(DENSE_GROUPS):
        ball = canonical.vertices[groups[name]]
        middle = 0.5 * (ball.amin(dim=0) + ball.amax(dim=0))
        forwards = torch.nn.functional.normalize(ball - middle, dim=1)[:, 2]
        is_iris = forwards > math.cos(math.radians(IRIS_DEGREES))
        factors[groups[name]] = torch.where(is_iris, IRIS_FACTOR, SPARSE_FACTOR)
    return factors[canonical.topology.faces.long()].median(dim=1).values


def _systematic_sample(expected: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """(count,) face ids; each face gets its expected number, rounded up or down."""
    cumulative = expected.double().cumsum(0)
    offset = torch.rand(1, generator=generator, dtype=torch.float64)
    marks = (torch.arange(count, dtype=torch.float64) + offset).to(expected.device) / count * cumulative[-1]
    return torch.searchsorted(cumulative, marks).clamp(max=len(expected) - 1)


def _uniform_barycentrics(count: int, generator: torch.Generator) -> torch.Tensor:
    """(count, 3) uniform over the triangle: the unit square folded along its diagonal."""
    pair = torch.rand(count, 2, generator=generator)
    folded = torch.where(pair.sum(dim=1, keepdim=True) > 1.0, 1.0 - pair, pair)
    return torch.cat([folded, 1.0 - folded.sum(dim=1, keepdim=True)], dim=1)
