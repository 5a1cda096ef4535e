"""The lookups of `samira_warp.kernels.cubemap.lookup` in plain torch, for any floating dtype."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.cubemap.layout import FACES, face_axes, texel_index


def sample_cubemap(cubemap: Tensor, directions: Tensor) -> Tensor:
    """As `samira_warp.kernels.cubemap.lookup.sample_cubemap`.

    Each face is widened by a border of its neighbours' texels, then looked up.
    """
    size = cubemap.shape[1]
    padded = pad_faces(cubemap)
    seen = (directions != 0).any(dim=-1)
    face, s, t = find_face(torch.where(seen[:, None], directions, torch.ones_like(directions)))
    column = (s + 1) * size / 2 + 0.5
    row = (t + 1) * size / 2 + 0.5
    i = column.detach().floor().long().clamp(0, size)
    j = row.detach().floor().long().clamp(0, size)
    x, y = (column - i)[:, None], (row - j)[:, None]
    upper = padded[face, j, i] * (1 - x) + padded[face, j, i + 1] * x
    lower = padded[face, j + 1, i] * (1 - x) + padded[face, j + 1, i + 1] * x
    return torch.where(seen[:, None], upper * (1 - y) + lower * y, torch.zeros_like(upper))


def sample_mips(mips: tuple[Tensor, ...], directions: Tensor, levels: Tensor) -> Tensor:
    """As `samira_warp.kernels.cubemap.lookup.sample_mips`."""
    seen = torch.stack([sample_cubemap(mip, directions) for mip in mips], dim=1)
    last = len(mips) - 1
    levels = levels.clamp(0, last)
    first = levels.detach().floor().long().clamp(0, max(last - 1, 0))
    fraction = (levels - first)[:, None]
    rows = torch.arange(directions.shape[0], device=directions.device)
    return seen[rows, first] * (1 - fraction) + seen[rows, (first + 1).clamp(max=last)] * fraction


def find_face(directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Face (M,) int64 that directions (M, 3) meet, and their coordinates s and t (M,) on it, -1 to 1."""
    axis = directions.detach().abs().argmax(dim=-1)
    major = directions.gather(-1, axis[:, None])[:, 0]
    face = 2 * axis + (major < 0)
    axes = face_axes(directions.device).to(directions)[face]
    s = (directions * axes[:, 0]).sum(dim=-1) / major.abs()
    t = (directions * axes[:, 1]).sum(dim=-1) / major.abs()
    return face, s, t


def pad_faces(cubemap: Tensor) -> Tensor:
    """(6, S + 2, S + 2, C): each face with its neighbours' border texels round it.

    Corners are the mean of the three texels that meet.
    """
    size, channels = cubemap.shape[1], cubemap.shape[-1]
    flat = cubemap.reshape(-1, channels)
    steps = 2 * torch.arange(-1, size + 1, device=cubemap.device) + 1 - size
    axes = face_axes(cubemap.device)
    faces = []
    for face in range(FACES):
        t, s = torch.meshgrid(steps, steps, indexing="ij")
        over = torch.maximum(s.abs(), t.abs()) > size
        # a point one step over an edge folds down onto the neighbour: (S + 1, t, S) becomes (S, t, S - 1)
        major = torch.where(over, size - 1, size)
        folded = torch.stack([s, t, major], dim=-1).clamp(-size, size)
        corner = (s.abs() > size) & (t.abs() > size)
        corner_texel = torch.tensor([size, size - 1, size - 1], device=cubemap.device)
        point = torch.where(corner[..., None], corner_texel, (folded[..., None] * axes[face]).sum(dim=-2))
        faces.append(flat[texel_index(point, size)])
    padded = torch.stack(faces)
    for j, inner_j in ((0, 1), (size + 1, size)):
        for i, inner_i in ((0, 1), (size + 1, size)):
            mean = (padded[:, inner_j, inner_i] + padded[:, j, inner_i] + padded[:, inner_j, i]) / 3
            mask = torch.zeros_like(padded[..., :1])
            mask[:, j, i] = 1
            padded = padded * (1 - mask) + mask * mean[:, None, None]
    return padded
