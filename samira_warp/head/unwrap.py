"""From frames to a texture in the UV atlas, through the tracked mesh."""

from __future__ import annotations

from typing import NamedTuple

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head.atlas import UvAtlas
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.rays.visibility import visible

GRAZING_COSINE = 0.2
"""Texels seen at less than this cosine are not read: their pixels are mixed with what lies beside them."""

OPAQUE = 0.95
"""Pixels less covered than this are mixed with the background."""


class UnwrapView(NamedTuple):
    """A picture of the head, and where the head is in it.

    Attributes:
        image: (H, W, C) values to unwrap.
        mask: (H, W) coverage.
        vertices: (V, 3) the posed mesh, metres.
        camera: The camera, at the picture's size.
        shading: (V, C) positive factors of the surface's values in the picture, which is divided by them;
            None for a picture of the values themselves.
    """

    image: Tensor
    mask: Tensor
    vertices: Tensor
    camera: Camera
    shading: Tensor | None = None


@torch.no_grad()
def unwrap(
    views: list[UnwrapView],
    *,
    atlas: UvAtlas,
    vertices: Tensor,
    faces: Tensor,
    otherwise: Tensor | None = None,
) -> Tensor:
    """Average what the views see of each texel, by the cosine at which they see it.

    A texel that no view sees takes the value of the nearest seen point to its mirror image in x on the
    reference mesh (heads are about symmetric); texels outside the atlas, and everything if nothing is seen,
    take the mean.

    Args:
        views: At least one.
        atlas: The head's UV layout.
        vertices: (V, 3) reference mesh, metres.
        faces: (F, 3) vertex ids.
        otherwise: (V, C) values of the vertices, for texels that no view sees, in place of the mirrored ones.

    Returns:
        (h, w, C) values on the atlas's texels.
    """
    size = atlas.size
    total = torch.zeros(size * size, views[0].image.shape[-1], device=vertices.device)
    weight = torch.zeros(size * size, 1, device=total.device)
    mesh = RayMesh(vertices, faces)
    for view in views:
        seen, values = _read_view(view, atlas, faces, mesh)
        total += seen * values
        weight += seen
    known = weight[:, 0] > 0.0
    texture = total / weight.clamp(min=1e-6)
    mean = texture[known].mean(dim=0) if bool(known.any()) else torch.full_like(texture[0], 0.5)
    texture[~known] = mean
    missing = atlas.valid.flatten() & ~known
    if otherwise is not None:
        texture[missing] = atlas.positions(otherwise).flatten(0, 1)[missing]
    elif bool(known.any()) and bool(missing.any()):
        positions = atlas.positions(vertices).flatten(0, 1)
        texture[missing] = texture[known][_nearest_mirrored(positions, known, missing)]
    return texture.unflatten(0, (size, size))


def _read_view(view: UnwrapView, atlas: UvAtlas, faces: Tensor, mesh: RayMesh) -> tuple[Tensor, Tensor]:
    """Weight (T, 1) and value (T, C) of every texel in one view, which the mesh is moved to.

    The weight is 0 where the view does not see the texel.
    """
    mesh.refit(view.vertices)
    points = atlas.positions(view.vertices).flatten(0, 1)
    normals = atlas.positions(vertex_normals(view.vertices, faces)).flatten(0, 1)
    towards = torch.nn.functional.normalize(view.camera.center - points, dim=1)
    cosine = (torch.nn.functional.normalize(normals, dim=1) * towards).sum(dim=1)
    pixel = view.camera.image_points(points)[:, :2]
    grid = (2.0 * pixel / points.new_tensor([view.camera.width, view.camera.height]) - 1.0)[None, None]
    stacked = torch.cat([view.image, view.mask[..., None]], dim=-1).permute(2, 0, 1)[None]
    sampled = torch.nn.functional.grid_sample(stacked, grid, align_corners=False)[0, :, 0].T
    seen = visible(points, mesh, origin=view.camera.center)
    seen &= atlas.valid.flatten() & (cosine > GRAZING_COSINE) & (sampled[:, -1] > OPAQUE)
    values = sampled[:, :-1]
    if view.shading is not None:
        # texels outside the atlas have none
        values = values / atlas.positions(view.shading).flatten(0, 1).clamp(min=1e-6)
    return torch.where(seen, cosine, 0.0)[:, None], values


def _nearest_mirrored(positions: Tensor, known: Tensor, missing: Tensor) -> Tensor:
    """For each missing texel, which of the known ones is nearest to its mirror image in x."""
    mirrored = positions[missing] * positions.new_tensor([-1.0, 1.0, 1.0])
    _, nearest = cKDTree(positions[known].cpu().numpy()).query(mirrored.cpu().numpy())
    return torch.from_numpy(nearest).to(positions.device)
