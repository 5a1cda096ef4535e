"""Times of blocked directions from a head's vertices: ours, Warp's own rays and Embree's, in turns."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from samira_warp.bench.embree_peer import embree_ms
from samira_warp.bench.timing import hardware, least_ms, print_table
from samira_warp.data.subjects import made_subject
from samira_warp.head import FrameParameters, Rig
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.rays import occlusion_cuda
from samira_warp.kernels.rays.occlusion import unblocked
from samira_warp.kernels.rays.ray_mesh import RayMesh

REPEATS = 5
FACE = 8
"""Texels to a side of the cubemap whose directions are asked for."""

BLOCK = 4
OFFSET = 1e-6


@dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes:
        threads: CPU threads; 0 on a GPU.
        points: The head's vertices.
        triangles: Its faces.
        rays: Directions above the points' horizons.
        blocked: Share of those that are blocked.
        frame_ms: `unblocked`, of all points and directions.
        refit_ms: `RayMesh.refit`, both trees.
        rays_per_s: Of `unblocked`.
        warp_rays_per_s: Of a plain kernel with `wp.mesh_query_ray_anyhit`, on the row's threads.
        embree_rays_per_s: Of Embree on one thread, on the CPU where it is installed.
        over_warp: `rays_per_s` over `warp_rays_per_s`.
        over_embree: `rays_per_s` over `embree_rays_per_s`.
        hardware: What computed.
    """

    threads: int
    points: int
    triangles: int
    rays: int
    blocked: float
    frame_ms: float
    refit_ms: float
    rays_per_s: float
    warp_rays_per_s: float
    embree_rays_per_s: float | None
    over_warp: float
    over_embree: float | None
    hardware: str


def main(device: str, json: bool) -> None:
    """Print the measurements as a table, or as a JSON list of rows."""
    rows = [asdict(row) for row in run(torch.device(device))]
    if json:
        print(json_format.dumps(rows))
        return
    print(hardware(torch.device(device)))
    print_table([{name: _text(value) for name, value in row.items() if name != "hardware"} for row in rows])


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "-" if value is None else str(value)


def run(device: torch.device) -> Iterator[Row]:
    """Measure with one thread and with as many as torch uses; on a GPU once."""
    threads_before = torch.get_num_threads()
    counts = (0,) if device.type == "cuda" else tuple(dict.fromkeys((1, threads_before)))
    vertices, faces, normals = (tensor.to(device) for tensor in _posed_head())
    try:
        for threads in counts:
            torch.set_num_threads(threads or threads_before)
            yield _row(vertices, faces, normals, cube_directions().to(device), threads)
    finally:
        torch.set_num_threads(threads_before)


def cube_directions() -> Tensor:
    """(384, 3) unit directions of a cubemap's texels, block by block of 4 x 4 texels of a face."""
    place = (torch.arange(FACE) + 0.5) * (2.0 / FACE) - 1.0
    v, u = torch.meshgrid(place, place, indexing="ij")
    face = torch.stack([torch.ones_like(u), u, v])
    blocks = face.unfold(1, BLOCK, BLOCK).unfold(2, BLOCK, BLOCK).reshape(3, -1).T
    faces = [sign * blocks.roll(axis, dims=1) for axis in range(3) for sign in (1.0, -1.0)]
    return torch.nn.functional.normalize(torch.cat(faces), dim=1)


def _posed_head() -> tuple[Tensor, Tensor, Tensor]:
    """Vertices, faces and normals of the built-in head, turned, with a random expression."""
    template = made_subject().head()
    rig = Rig.build(template)
    generator = torch.Generator().manual_seed(0)
    rotations = torch.zeros(len(template.joint_names), 3)
    rotations[template.joint_names.index(template.head_joint)] = torch.tensor([0.1, 0.3, 0.05])
    parameters = FrameParameters(
        translation=torch.tensor([0.1, -0.2, 0.3]),
        rotations=rotations,
        expression=0.4 * torch.rand(len(template.expression_names), generator=generator),
    )
    vertices = rig.pose(parameters, torch.zeros(template.n_shape)).vertices
    faces = torch.from_numpy(template.faces)
    normals = mesh_normals(vertices[None], MeshTopology.build(faces, len(vertices)))[0]
    return vertices, faces, normals


def _row(vertices: Tensor, faces: Tensor, normals: Tensor, directions: Tensor, threads: int) -> Row:
    device, mesh = vertices.device, RayMesh(vertices, faces)
    above = normals @ directions.T > 0
    points, ways = above.nonzero(as_tuple=True)
    bits = unblocked(vertices, normals, mesh, directions, offset=OFFSET)
    plain = torch.empty_like(bits)

    def ours() -> Tensor:
        return unblocked(vertices, normals, mesh, directions, offset=OFFSET)

    def warps() -> None:
        occlusion_cuda.occlusion(vertices, normals, mesh, directions, OFFSET, plain)

    frame_ms = least_ms(ours, device, repeats=REPEATS)
    warp_ms = least_ms(warps, device, repeats=1)
    embree: float | None = None
    if device.type == "cpu":
        origins = vertices[points] + OFFSET * normals[points]
        embree = embree_ms(vertices, faces, origins, directions[ways])
    refit_ms = least_ms(lambda: mesh.refit(vertices), device, repeats=REPEATS)
    rays = len(points)
    unset = (bits[..., None] >> torch.arange(32, device=device)) & 1
    return Row(
        threads=threads,
        points=len(vertices),
        triangles=len(faces),
        rays=rays,
        blocked=1.0 - (unset.sum().item() - (~above).sum().item()) / rays,
        frame_ms=frame_ms,
        refit_ms=refit_ms,
        rays_per_s=1e3 * rays / frame_ms,
        warp_rays_per_s=1e3 * rays / warp_ms,
        embree_rays_per_s=None if embree is None else 1e3 * rays / embree,
        over_warp=warp_ms / frame_ms,
        over_embree=None if embree is None else embree / frame_ms,
        hardware=hardware(device),
    )
