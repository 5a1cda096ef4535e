"""The blending across outlines of `samira_warp.kernels.mesh.antialias` in plain torch, pair by pair."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.mesh.mesh_raster import MeshRaster
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.support.constants import NEAR_PLANE


def antialias(image: Tensor, raster: MeshRaster, points: Tensor, topology: MeshTopology) -> Tensor:
    """Blend pixels across the mesh's outlines: (B, H, W, C); a loop over the pixels of the image."""
    return torch.stack(
        [
            _antialias(frame, face, barycentrics, vertices, topology)
            for frame, face, barycentrics, vertices in zip(
                image, raster.face, raster.barycentrics.detach(), points, strict=True
            )
        ]
    )


def _antialias(
    image: Tensor, face: Tensor, barycentrics: Tensor, points: Tensor, topology: MeshTopology
) -> Tensor:
    depth = _depths(face, barycentrics, points.detach(), topology)
    change = torch.zeros_like(image)
    for steep in (True, False):
        # in rows, and in columns as rows of the image turned over its diagonal
        order = [0, 1, 2] if steep else [1, 0, 2]
        turned = points[:, order]
        shifts = _shifts(turned, face if steep else face.T, depth if steep else depth.T, topology, steep)
        colors = image if steep else image.transpose(0, 1)
        step = colors[:, :-1] - colors[:, 1:]
        zero = torch.zeros_like(step[:, :1])
        taken = shifts.clamp(min=0)[..., None] * step
        given = shifts.clamp(max=0)[..., None] * step
        moved = torch.cat([zero, taken], dim=1) + torch.cat([given, zero], dim=1)
        change = change + (moved if steep else moved.transpose(0, 1))
    return image + change


def _depths(face: Tensor, barycentrics: Tensor, points: Tensor, topology: MeshTopology) -> Tensor:
    """(H, W) depth of what is seen, infinite where nothing is."""
    corners = points[topology.faces.long()[face.long().clamp(min=0)], 2]
    return torch.where(face >= 0, (barycentrics * corners).sum(dim=-1), torch.inf)


def _shifts(points: Tensor, face: Tensor, depth: Tensor, topology: MeshTopology, steep: bool) -> Tensor:
    """(H, W - 1) positions of the outlines between neighbours in a row, from the middle; 0 without one."""
    ends, opposites, _ = topology.edges
    a, b = points[ends.long()].unbind(dim=1)
    rise, run = (b - a)[:, 1], (b - a)[:, 0]
    mine = (rise.abs() >= run.abs()) if steep else (rise.abs() > run.abs())
    sides = torch.stack([_side(a, b, points, opposites[:, which]) for which in (0, 1)]).sum(dim=0)
    # of a line that goes down the image, negative areas are to its right
    side = -sides.sign() * rise.detach().sign()
    mine = mine & (side != 0) & (a[:, 2] > NEAR_PLANE) & (b[:, 2] > NEAR_PLANE)
    height, width = face.shape
    shifts = []
    for row in range(height):
        meets = (torch.minimum(a, b)[:, 1] <= row + 0.5) & (torch.maximum(a, b)[:, 1] > row + 0.5) & mine
        chosen = [points.new_zeros(())] * (width - 1)
        outermost = [float("inf")] * (width - 1)
        for edge in meets.nonzero().flatten().tolist():
            part = (row + 0.5 - a[edge, 1]) / rise[edge]
            x = a[edge, 0] + part * run[edge]
            left = int((x.detach() - 0.5).floor())
            if not 0 <= left < width - 1:
                continue
            own, other = (left + 1, left) if side[edge] > 0 else (left, left + 1)
            at = float(1 / ((1 - part) / a[edge, 2] + part / b[edge, 2]).detach())
            seen = face[row, own] >= 0 and face[row, own] != face[row, other]
            shift = x - (left + 1)
            bare = 0.5 + float(side[edge]) * float(shift.detach())
            if seen and depth[row, other] > max(float(depth[row, own]), at) and bare < outermost[left]:
                chosen[left], outermost[left] = shift, bare
        shifts.append(torch.stack(chosen))
    return torch.stack(shifts)


def _side(a: Tensor, b: Tensor, points: Tensor, opposite: Tensor) -> Tensor:
    """(E,) sign of the area that the third vertex spans with an edge; 0 without one."""
    p = points[opposite.long().clamp(min=0)]
    area = (b - a)[:, 0] * (p - a)[:, 1] - (b - a)[:, 1] * (p - a)[:, 0]
    return torch.where((opposite >= 0) & (p[:, 2] > NEAR_PLANE), area.sign(), 0.0).detach()
