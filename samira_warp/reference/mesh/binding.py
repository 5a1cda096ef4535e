"""The binding of `samira_warp.kernels.mesh.binding` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.binding import BoundGaussians, FaceBinding
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames


def bind(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    normals: Tensor,
    binding: FaceBinding,
    frames: TriangleFrames,
) -> BoundGaussians:
    """Mu' = k r mu + t, q' = quat(r) q / |q|, s' = k s (Eq. lbs), n' = norm(r n) (Eq. normal_transform).

    The gradient with respect to r is here the one of each entry by itself; its tangential part is the
    kernel's.
    """
    faces = binding.faces.long()
    r, t, k = frames.rotation[faces], frames.translation[faces], frames.scale[faces, None]
    identity = quaternions.new_tensor([1.0, 0.0, 0.0, 0.0])
    is_zero = (quaternions == 0).all(dim=1, keepdim=True)
    local = torch.nn.functional.normalize(torch.where(is_zero, identity, quaternions), dim=1)
    return BoundGaussians(
        means=k * _turn(r, means) + t,
        quaternions=quaternion_product(rotation_to_quaternion(r), local),
        scales=k * scales,
        normals=torch.nn.functional.normalize(_turn(r, normals), dim=1, eps=1e-30),
    )


def _turn(rotation: Tensor, vectors: Tensor) -> Tensor:
    return (rotation @ vectors[..., None]).squeeze(-1)


def quaternion_product(p: Tensor, q: Tensor) -> Tensor:
    """Hamilton product p q of (..., 4) quaternions (w, x, y, z): first q's turn, then p's."""
    pw, pv = p[..., :1], p[..., 1:]
    qw, qv = q[..., :1], q[..., 1:]
    scalar = pw * qw - (pv * qv).sum(dim=-1, keepdim=True)
    vector = pw * qv + qw * pv + torch.linalg.cross(pv, qv)
    return torch.cat([scalar, vector], dim=-1)


def rotation_to_quaternion(rotation: Tensor) -> Tensor:
    """Unit quaternions (N, 4) (w, x, y, z) of (N, 3, 3) rotations, by their largest component (Shepperd)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (row.unbind(dim=-1) for row in rotation.unbind(dim=-2))
    w, x, y, z = 1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz
    candidates = torch.stack(
        [
            torch.stack([w, zy - yz, xz - zx, yx - xy], dim=-1),
            torch.stack([zy - yz, x, xy + yx, xz + zx], dim=-1),
            torch.stack([xz - zx, xy + yx, y, yz + zy], dim=-1),
            torch.stack([yx - xy, xz + zx, yz + zy, z], dim=-1),
        ],
        dim=1,
    )
    largest = torch.stack([w, x, y, z], dim=1).argmax(dim=1)
    return torch.nn.functional.normalize(
        candidates[torch.arange(len(rotation), device=rotation.device), largest], dim=1
    )
