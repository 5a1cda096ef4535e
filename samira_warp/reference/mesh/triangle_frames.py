"""The frames of `samira_warp.kernels.mesh.triangle_frames` in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames
from samira_warp.support.constants import DEGENERATE_TRIANGLE


def triangle_frames(vertices: Tensor, topology: MeshTopology) -> TriangleFrames:
    """Frame r, t, k of every triangle; where one is degenerate r = 1 and k are constants."""
    a, b, c = vertices[topology.faces.long()].unbind(dim=1)
    edge, side = b - a, c - a
    degenerate = _is_degenerate(edge.detach(), side.detach())
    edge = torch.where(degenerate[:, None], edge.new_tensor([1.0, 0.0, 0.0]), edge)
    side = torch.where(degenerate[:, None], side.new_tensor([0.0, 0.0, -1.0]), side)

    length = edge.norm(dim=1)
    direction = edge / length[:, None]
    perpendicular = torch.linalg.cross(direction, side)
    height = perpendicular.norm(dim=1)
    normal = perpendicular / height[:, None]
    rotation = torch.stack([direction, normal, torch.linalg.cross(direction, normal)], dim=2)

    true_scale = _scale((b - a).detach(), (c - a).detach())
    scale = torch.where(degenerate, true_scale, (length + height) / 2)
    return TriangleFrames(rotation, (a + b + c) / 3, scale)


def _height(edge: Tensor, side: Tensor) -> Tensor:
    return torch.linalg.cross(torch.nn.functional.normalize(edge, dim=1, eps=1e-30), side).norm(dim=1)


def _scale(edge: Tensor, side: Tensor) -> Tensor:
    return (edge.norm(dim=1) + _height(edge, side)) / 2


def _is_degenerate(edge: Tensor, side: Tensor) -> Tensor:
    length = edge.norm(dim=1)
    longest = torch.maximum(length, side.norm(dim=1))
    return ~((length > 0) & (_height(edge, side) > DEGENERATE_TRIANGLE * longest))
