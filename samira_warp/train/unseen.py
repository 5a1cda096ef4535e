"""What no training picture saw, made a good guess: the surface of the mesh, in the colours next to it.

Gaussians that no picture shows get no gradient: they stay as they were first thrown, half transparent, in
whatever colour an unwrapped picture had nearest; and what is seen at a grazing angle alone is pulled about
from one side only. Late in training these become discs in their triangles' planes and take over what lies
nearest on the surface and was seen, of this side or, mirrored, of the other. In the steps that are left they
rest, and what was seen fits the outlines that they take part in.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from samira_warp.avatar import Avatar, Gaussians, Motion
from samira_warp.avatar.gbuffer import GBuffer
from samira_warp.geometry.camera import Camera
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import FrameParameters
from samira_warp.kernels.gathering.grouping import group_by
from samira_warp.kernels.gathering.sums import sum_groups
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.kernels.raster.rasterizer import blend_again
from samira_warp.train.density import spacing
from samira_warp.train.initialize import FLATNESS, SIZE_IN_SPACINGS
from samira_warp.train.neighbours import Neighbourhood

FACING = 0.17
"""Cosine, 80 degrees: a triangle is seen where some pixel shows it, turned away from the camera by less.
Those along the outline share their pixels with what is behind."""

MADE_UP = 1.0
"""Pixels of all pictures that a Gaussian has to make up to lend others what it has."""

SOLID = 0.5
"""Coverage above which a seen triangle is the head's; what has mostly others next to it is left out as they
are: mattes end at the shoulders where meshes go on."""

OPACITY = 0.9
"""Of what is guessed: discs overlap, and next to nothing of the inside shines through."""

EMPTY = 0.1
"""Coverage below which a seen triangle is none of the head's, whatever a faint Gaussian on it adds."""

LEFT_OUT = 1e-3
"""Opacity of what mattes leave out."""

DONORS = 16
"""Seen Gaussians whose values are mixed, each by its opacity over the square of its distance."""

BORROWED = ("albedo_logits", "roughness_logits", "specular_logits")
"""What is taken over."""

_LEAST_SQUARE = 1e-8
"""Square metres added to a squared distance: a tenth of a millimetre is next to nothing."""


class Seen(NamedTuple):
    """What some pictures saw of an avatar.

    Attributes:
        pixels: (N,) how many pixels each Gaussian makes up, in all.
        faces: (F,) bool, whether some pixel shows a triangle that faces the camera by FACING.
        coverage: (F,) mean alpha of those pixels; 0 where there is none.
    """

    pixels: Tensor
    faces: Tensor
    coverage: Tensor


def look(avatar: Avatar, views: Iterable[tuple[FrameParameters, Camera]]) -> Seen:
    """See what some views see of an avatar."""
    device, count = avatar.gaussians.means.device, len(avatar.canonical.topology.faces)
    pixels = torch.zeros(len(avatar.gaussians), device=device)
    shown, covered = torch.zeros(count, device=device), torch.zeros(count, device=device)
    for parameters, camera in views:
        with torch.no_grad():
            motion = avatar.move(parameters)
            gbuffer = avatar.rasterize(motion, camera)
            ids = _facing(avatar, motion, camera)
            inside = ids >= 0
            # not `torch.bincount`: on a GPU it adds weights in any order
            by_face = group_by(ids[inside], count)
            shown += by_face.offsets.diff()
            covered += sum_groups(gbuffer.alpha[inside][None], by_face)[0, :, 0]
        pixels += _shares(gbuffer, len(pixels))
    return Seen(pixels, shown > 0, covered / shown.clamp(min=1.0))


def _facing(avatar: Avatar, motion: Motion, camera: Camera) -> Tensor:
    """(H, W) id of the triangle that each pixel of a view shows; -1 where none does, or faces away."""
    topology, vertices = avatar.canonical.topology, motion.head.vertices
    points = camera.image_points(vertices)[None]
    ids = rasterize_mesh(points, topology, width=camera.width, height=camera.height).face[0].long()
    corners = vertices[topology.faces.long()]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = camera.center - corners.mean(dim=1)
    cosines = torch.nn.functional.cosine_similarity(normals, towards, dim=1)
    # an id of -1 looks at the last triangle, and stays what it is
    return torch.where(cosines[ids] > FACING, ids, -1)


def _shares(gbuffer: GBuffer, count: int) -> Tensor:
    """(N,) pixels that each Gaussian makes up: the adjoint of blending ones."""
    ones = torch.ones(count, 1, device=gbuffer.alpha.device, requires_grad=True)
    (shares,) = torch.autograd.grad(blend_again(gbuffer.splats, ones).sum(), ones)
    return shares[:, 0]


@torch.no_grad()
def guess_unseen(avatar: Avatar, seen: Seen, neighbourhood: Neighbourhood) -> int:
    """Make discs on the surface of what was not seen.

    Args:
        avatar: Its Gaussians are changed in place.
        seen: What training saw of it.
        neighbourhood: Of its Gaussians.

    Returns:
        How many Gaussians are guesses now: `Gaussians.guessed`.
    """
    gaussians = avatar.gaussians
    faces = gaussians.faces.long()
    there = seen.faces[faces]
    neighbours = neighbourhood.table.indices.long()
    # small triangles slip between pixels: where most neighbours were seen, so was this
    unseen = ~there & (there[neighbours].float().mean(dim=1) <= 0.5)
    solid = seen.coverage[faces] > SOLID
    donors = there & solid & (seen.pixels >= MADE_UP)
    if not unseen.any() or not donors.any():
        return 0
    # positions and normals: what lies next to an unseen eyeball may be a lid
    places = neighbourhood.places[:, :6]
    _lay_on_surface(avatar, unseen, _borrow(avatar, places, unseen, donors))
    count = range(1, min(DONORS, int(there.sum())) + 1)
    nearest = cKDTree(places[there.cpu().numpy()]).query(places[unseen.cpu().numpy()], k=count)[1]
    is_head = solid[there][torch.from_numpy(nearest).to(solid.device)].float().mean(dim=1) > SOLID
    opacities = torch.where(is_head, OPACITY, LEFT_OUT).to(gaussians.opacity_logits)
    gaussians.opacity_logits[unseen] = torch.logit(opacities)
    empty = there & (seen.coverage[faces] < EMPTY)
    gaussians.opacity_logits[empty] = torch.logit(gaussians.opacity_logits.new_tensor(LEFT_OUT))
    gaussians.guessed = unseen
    return int(unseen.sum())


def hold_guesses(gaussians: Gaussians) -> None:
    """Clear the gradients of guesses, after a backward pass.

    What is seen of them is their edge at most, which they would be pulled about for, and stained.
    """
    for name in Gaussians.PARAMETERS:
        gradient = getattr(gaussians, name).grad
        if gradient is not None:
            gradient[gaussians.guessed] = 0.0


def _lay_on_surface(avatar: Avatar, which: Tensor, heights: Tensor) -> None:
    """Make discs of some Gaussians, as large as their share of the triangle, at (M,) heights in metres."""
    gaussians, canonical = avatar.gaussians, avatar.canonical
    faces = gaussians.faces.long()
    areas = face_areas(canonical.vertices, canonical.topology.faces)
    scales = triangle_frames(canonical.vertices, canonical.topology).scale[faces]
    spread = (SIZE_IN_SPACINGS * spacing(faces, areas) / scales)[:, None]
    discs = torch.cat([spread, FLATNESS * spread, spread], dim=1).log()
    gaussians.log_scales[which] = discs[which]
    gaussians.means[which, 1] = heights / scales[which]
    gaussians.quaternions[which] = gaussians.quaternions.new_tensor([1.0, 0.0, 0.0, 0.0])
    gaussians.normals[which] = gaussians.initial_normals[which]


def _borrow(avatar: Avatar, places: np.ndarray, unseen: Tensor, donors: Tensor) -> Tensor:
    """Give the unseen what the nearest donors of either side have, in the mean.

    Args:
        avatar: Its Gaussians' BORROWED are changed in place.
        places: (N, 6) positions and normals at rest; x is to the side.
        unseen: (N,) bool.
        donors: (N,) bool.

    Returns:
        (M,) heights above their triangles, metres: an outline is where it should be when what makes it lies a
        little below the surface.
    """
    gaussians, canonical = avatar.gaussians, avatar.canonical
    ids = donors.nonzero()[:, 0].cpu().numpy()
    mirrored = places[ids] * np.array([-1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    nearest = range(1, min(DONORS, 2 * len(ids)) + 1)
    tree = cKDTree(np.concatenate([places[ids], mirrored]))
    distances, found = tree.query(places[unseen.cpu().numpy()], k=nearest)
    sources = torch.from_numpy(np.concatenate([ids, ids])[found]).to(unseen.device)
    shares = torch.from_numpy(1.0 / (distances**2 + _LEAST_SQUARE)).to(gaussians.means)
    shares = shares * gaussians.opacities[sources]
    shares = (shares / shares.sum(dim=1, keepdim=True))[:, :, None]
    for name in BORROWED:
        values = getattr(gaussians, name)
        flat = values.reshape(len(values), -1)
        values[unseen] = (shares * flat[sources]).sum(dim=1).reshape(-1, *values.shape[1:])
    scales = triangle_frames(canonical.vertices, canonical.topology).scale[gaussians.faces.long()]
    heights = gaussians.means[:, 1] * scales
    return (shares[:, :, 0] * heights[sources]).sum(dim=1)
