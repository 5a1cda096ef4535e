"""What no training picture saw, made a good guess: the surface of the mesh, in the colours next to it.

Gaussians that no picture shows get no gradient: they stay as they were first thrown, half transparent, in
whatever colour an unwrapped picture had nearest, and what borders on them was pulled about from one side
only. When training is done they become discs on their triangles, opaque, and take over what lies nearest on
the surface and was seen, of this side or, mirrored, of the other.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from samira_warp.avatar import Avatar, Gaussians
from samira_warp.geometry.camera import Camera
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.kernels.raster.rasterizer import blend_again
from samira_warp.train.density import spacing
from samira_warp.train.initialize import FLATNESS, SIZE_IN_SPACINGS
from samira_warp.train.neighbours import neighbourhood, rest_places

SEEN_PIXELS = 1.0
"""Of all the pictures that are looked at, a Gaussian's share of fewer pixels than this is a glimpse."""

OPACITY = 0.95
"""Of what is guessed: neighbours overlap, and nothing shines through."""

DONORS = 16
"""Seen Gaussians whose values are mixed, each by the inverse square of its distance."""

BORROWED = ("albedo_logits", "roughness_logits", "specular_logits")
"""What is taken over."""

_LEAST_SQUARE = 1e-8
"""Square metres added to a squared distance: a tenth of a millimetre is next to nothing."""


def seen_pixels(avatar: Avatar, views: Iterable[tuple[FrameParameters, Camera]]) -> Tensor:
    """(N,) how many pixels each Gaussian makes up, summed over views."""
    total = torch.zeros(len(avatar.gaussians), device=avatar.gaussians.means.device)
    for parameters, camera in views:
        with torch.no_grad():
            splats = avatar.rasterize(avatar.move(parameters), camera).splats
        share = torch.ones(len(total), 1, device=total.device, requires_grad=True)
        (weights,) = torch.autograd.grad(blend_again(splats, share).sum(), share)
        total += weights[:, 0]
    return total


@torch.no_grad()
def guess_unseen(avatar: Avatar, seen: Tensor) -> int:
    """Make discs on the surface of what was not seen.

    Args:
        avatar: Its Gaussians are changed in place.
        seen: (N,) from `seen_pixels`.

    Returns:
        How many Gaussians are guesses now.
    """
    gaussians, canonical = avatar.gaussians, avatar.canonical
    glimpsed = seen >= SEEN_PIXELS
    neighbours = neighbourhood(gaussians, canonical).table.indices.long()
    # what lies below a seen surface is hidden by it, not unseen
    unseen = ~(glimpsed | glimpsed[neighbours].any(dim=1))
    if not unseen.any() or not glimpsed.any():
        return 0
    _lay_on_surface(avatar, unseen)
    _, places = rest_places(gaussians, canonical)
    _borrow(gaussians, places[:, :6], unseen=unseen, donors=glimpsed)
    return int(unseen.sum())


def _lay_on_surface(avatar: Avatar, which: Tensor) -> None:
    """Make discs of some Gaussians as large as their share of the triangle, in its plane."""
    gaussians, canonical = avatar.gaussians, avatar.canonical
    faces = gaussians.faces.long()
    areas = face_areas(canonical.vertices, canonical.topology.faces)
    scales = triangle_frames(canonical.vertices, canonical.topology).scale[faces]
    spread = (SIZE_IN_SPACINGS * spacing(faces, areas) / scales)[:, None]
    discs = torch.cat([spread, FLATNESS * spread, spread], dim=1).log()
    gaussians.log_scales[which] = discs[which]
    gaussians.means[which, 1] = 0.0
    gaussians.quaternions[which] = gaussians.quaternions.new_tensor([1.0, 0.0, 0.0, 0.0])
    gaussians.normals[which] = gaussians.initial_normals[which]
    gaussians.opacity_logits[which] = torch.logit(gaussians.opacity_logits.new_tensor(OPACITY))


def _borrow(gaussians: Gaussians, places: np.ndarray, *, unseen: Tensor, donors: Tensor) -> None:
    """Mix into the unseen what the nearest of the seen have, of either side.

    Args:
        gaussians: Changed in place.
        places: (N, 6) positions and normals at rest; x is to the side.
        unseen: (N,) bool.
        donors: (N,) bool.
    """
    ids = donors.nonzero()[:, 0].cpu().numpy()
    mirrored = places[ids] * np.array([-1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    count = min(DONORS, 2 * len(ids))
    distances, found = cKDTree(np.concatenate([places[ids], mirrored])).query(
        places[unseen.cpu().numpy()], k=range(1, count + 1)
    )
    weights = 1.0 / (distances**2 + _LEAST_SQUARE)
    weights /= weights.sum(axis=1, keepdims=True)
    sources = torch.from_numpy(np.concatenate([ids, ids])[found]).to(unseen.device)
    shares = torch.from_numpy(weights).to(gaussians.means)
    for name in BORROWED:
        values = getattr(gaussians, name)
        flat = values.reshape(len(values), -1)
        mixed = (shares[:, :, None] * flat[sources]).sum(dim=1)
        values[unseen] = mixed.reshape(-1, *values.shape[1:])
