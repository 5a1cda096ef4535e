"""Which of a set of directions a mesh blocks, from many points, as bits."""

from __future__ import annotations

import torch
from torch import Tensor

from samira_warp.kernels.rays import occlusion_cpu, occlusion_cuda
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensors

WORD = 32
"""Directions to a word."""


def unblocked(
    points: Tensor, normals: Tensor, mesh: RayMesh, directions: Tensor, *, offset: float = 1e-6
) -> Tensor:
    """Tell in which directions points see past the mesh, triangles blocking from both sides.

    Bit k of word w is 1 where the ray from ``point + offset * normal`` in direction ``32 w + k`` meets no
    triangle. No ray is cast where ``dot(normal, direction) <= 0``: there the bit is 1 too, so that a point
    that nothing blocks has all bits, as has one whose normal is zero.

    The order of the directions does not matter to the result. It does to the time: let each 16 in a row, from
    a multiple of 16, be neighbours, such as a block of 4 x 4 texels of a cubemap's face.

    A triangle that is nowhere higher than ``offset`` above its point's horizon, the plane through it across
    the normal, blocks nothing from there: a convex body is unblocked to the bit wherever it stands, on the
    CPU. There a triangle is also larger than it is by some 4e-7 of its distance, so that no ray slips through
    an edge or a vertex that triangles share. On a GPU rays are Warp's, with its leaks (`RayMesh`). A triangle
    without area, or thinner than some 4e-6 of its length, blocks nothing.

    The same bits for any number of threads.

    Args:
        points: (M, 3) float32, usually the mesh's vertices.
        normals: (M, 3) float32, unit length, or zero for a point to cast nothing from.
        mesh: What may block, on the same device.
        directions: (D, 3) float32, unit length, D a multiple of 32.
        offset: How far in front of its point a ray begins, in the points' unit. The default suits metres.

    Returns:
        (M, D / 32) int32, bits of the directions in their order, the first the least significant.

    Raises:
        UserError: A tensor has another shape, dtype or device, or D is no multiple of 32.
    """
    device = mesh.vertices.device
    check_tensors(
        ("points", points, ("M", 3)),
        ("normals", normals, ("M", 3)),
        ("directions", directions, ("D", 3)),
        device=device,
    )
    if len(directions) % WORD:
        raise UserError("directions", expected=f"a multiple of {WORD} directions", found=f"{len(directions)}")
    result = torch.empty(len(points), len(directions) // WORD, dtype=torch.int32, device=device)
    if result.numel() == 0:
        return result
    inputs = (points.contiguous(), normals.contiguous(), mesh, directions.contiguous(), offset)
    side = occlusion_cuda if device.type == "cuda" else occlusion_cpu
    side.occlusion(*inputs, result)
    return result
