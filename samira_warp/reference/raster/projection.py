"""The projection of `samira_warp.kernels.raster.projection` in plain torch: its specification."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster.projection import Projection
from samira_warp.support.constants import ALPHA_MIN, LOW_PASS, NEAR_PLANE

FRUSTUM_MARGIN = 0.15
"""Share of the image's width added on either side: slopes in the Jacobian are held to 1.3 times the half
extent."""


def project(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, camera: Camera
) -> Projection:
    """As `samira_warp.kernels.raster.projection.project`, in the dtype of ``means``; finite inputs only."""
    pose = camera.world_to_camera.to(means)
    points = means @ pose[:3, :3].T + pose[:3, 3]
    depths = points[:, 2]
    in_front = depths > NEAR_PLANE
    z = torch.where(in_front, depths, torch.ones_like(depths))
    u, v = points[:, 0] / z, points[:, 1] / z
    means2d = torch.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], dim=-1)

    M = _image_axes(_rotations(quaternions), scales, pose[:3, :3], u, v, z, camera)
    covariances = M @ M.mT + LOW_PASS * torch.eye(2).to(z)
    area = torch.linalg.cross(M[:, 0], M[:, 1]).square().sum(dim=-1)
    # no slope where there is no area: such a Gaussian is not seen
    kept = torch.where(area > 0, (torch.where(area > 0, area, 1.0) / torch.linalg.det(covariances)).sqrt(), 0)
    inverse = torch.linalg.inv(covariances)
    conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], dim=-1)

    image = torch.tensor([0.5, 0.5, camera.width - 0.5, camera.height - 0.5]).to(means)
    visible = in_front & (least_sigma(means2d, conics, image) <= torch.log(kept * opacities / ALPHA_MIN))
    return Projection(
        torch.where(visible[:, None], means2d, 0.0),
        torch.where(visible, depths, 0.0),
        torch.where(visible[:, None], conics, 0.0),
        torch.where(visible, kept * opacities, 0.0),
        visible,
    )


def least_sigma(means2d: Tensor, conics: Tensor, rectangle: Tensor) -> Tensor:
    """Least (1/2) d' K d over the rectangle (left, top, right, bottom), any broadcast batch.

    It is 0 inside, else a minimum on the border.

    Args:
        means2d: (..., 2) pixels.
        conics: (..., 3).
        rectangle: (..., 4) pixels.
    """
    x, y = means2d.unbind(-1)
    xx, xy, yy = conics.unbind(-1)
    left, top, right, bottom = (
        edge - center for edge, center in zip(rectangle.unbind(-1), (x, y, x, y), strict=True)
    )

    def sigma(dx: Tensor, dy: Tensor) -> Tensor:
        return 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy

    inside = (left <= 0) & (right >= 0) & (top <= 0) & (bottom >= 0)
    vertical = [sigma(dx, torch.clamp(-xy * dx / yy, top, bottom)) for dx in (left, right)]
    horizontal = [sigma(torch.clamp(-xy * dy / xx, left, right), dy) for dy in (top, bottom)]
    border = torch.stack(torch.broadcast_tensors(*vertical, *horizontal)).amin(dim=0)
    return torch.where(inside, torch.zeros_like(border), border)


def _rotations(quaternions: Tensor) -> Tensor:
    """(N, 3, 3) rotation matrices of quaternions (w, x, y, z) of any length."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=-1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=-1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def _image_axes(
    R: Tensor, scales: Tensor, W: Tensor, u: Tensor, v: Tensor, z: Tensor, camera: Camera
) -> Tensor:
    """(N, 2, 3) M = J W R S, pixels: M M' is the covariance in the image.

    The slopes u = x/z and v = y/z are clamped in J.
    """
    margin_x, margin_y = FRUSTUM_MARGIN * camera.width / camera.fx, FRUSTUM_MARGIN * camera.height / camera.fy
    u = u.clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    v = v.clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack(
        [
            torch.stack([camera.fx / z, zero, -camera.fx * u / z], dim=-1),
            torch.stack([zero, camera.fy / z, -camera.fy * v / z], dim=-1),
        ],
        dim=-2,
    )
    return J @ W @ R * scales[:, None, :]
