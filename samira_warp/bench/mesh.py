"""Times of the mesh rasteriser on a batch of heads, by stage, forward and backward."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.bench.subject import make_camera, make_parameters, make_template
from samira_warp.bench.timing import hardware, least_ms, print_table
from samira_warp.head import FrameParameters, Rig
from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_raster import MeshRaster, rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology

REPEATS = 5
CHANNELS = 3
FRAMES = 16


class Sweep(NamedTuple):
    """What is measured, in every combination."""

    sizes: tuple[int, ...]
    threads: tuple[int, ...]


SWEEPS = {"cpu": Sweep((128, 256), (1, 2)), "cuda": Sweep((256, 512), (0,))}


@dataclass(frozen=True)
class Row:
    """One measurement, in milliseconds of a frame in a batch of FRAMES.

    Attributes:
        size: H = W, pixels.
        threads: CPU threads; 0 on a GPU.
        covered: Share of the pixels that show the head.
        rasterize_ms: `rasterize_mesh`.
        interpolate_ms: `interpolate`, of CHANNELS values that all frames share.
        antialias_ms: `antialias`.
        forward_ms: The three together.
        backward_ms: Their adjoints, to the points and the values.
        hardware: What computed.
    """

    size: int
    threads: int
    covered: float
    rasterize_ms: float
    interpolate_ms: float
    antialias_ms: float
    forward_ms: float
    backward_ms: float
    hardware: str


def main(device: str, json: bool) -> None:
    """Print the measurements as a table, or as a JSON list of rows."""
    on = torch.device(device)
    rows = [asdict(row) for row in run(on, SWEEPS[on.type])]
    if json:
        print(json_format.dumps(rows))
        return
    print(hardware(on))
    print_table([{name: _text(value) for name, value in row.items() if name != "hardware"} for row in rows])


def _text(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def run(device: torch.device, sweep: Sweep) -> Iterator[Row]:
    """Measure every combination of a sweep."""
    template = make_template()
    topology = MeshTopology.build(torch.from_numpy(template.faces), len(template.v_template)).to(device)
    parameters = FrameParameters.stack([make_parameters(seed) for seed in range(FRAMES)])
    vertices = Rig.build(template).pose(parameters, torch.zeros(0)).vertices
    threads_before = torch.get_num_threads()
    try:
        for size in sweep.sizes:
            points = _project(vertices, size).to(device)
            for threads in sweep.threads:
                torch.set_num_threads(threads or threads_before)
                yield _row(points, topology, size, threads)
    finally:
        torch.set_num_threads(threads_before)


def _project(vertices: Tensor, size: int) -> Tensor:
    """(B, V, 3) pixels and depth of (B, V, 3) vertices."""
    camera = make_camera(size)
    transform = camera.world_to_camera
    position = vertices @ transform[:3, :3].T + transform[:3, 3]
    focal, center = torch.tensor([camera.fx, camera.fy]), torch.tensor([camera.cx, camera.cy])
    return torch.cat([focal * position[..., :2] / position[..., 2:] + center, position[..., 2:]], dim=-1)


def _row(points: Tensor, topology: MeshTopology, size: int, threads: int) -> Row:
    leaves = [points.clone().requires_grad_(), points.new_ones(points.shape[1], CHANNELS).requires_grad_()]

    def rasterized() -> MeshRaster:
        return rasterize_mesh(leaves[0], topology, width=size, height=size)

    def interpolated() -> Tensor:
        return interpolate(leaves[1], raster, topology)

    def antialiased() -> Tensor:
        return antialias(image, raster, leaves[0], topology)

    raster = rasterized()
    image = interpolated()
    blended = antialiased()
    grad = torch.ones_like(blended)
    forward = [
        least_ms(stage, points.device, repeats=REPEATS) / FRAMES
        for stage in (rasterized, interpolated, antialiased)
    ]
    backward = least_ms(
        lambda: torch.autograd.grad(blended, leaves, grad, retain_graph=True), points.device, repeats=REPEATS
    )
    return Row(
        size=size,
        threads=threads,
        covered=(raster.face >= 0).float().mean().item(),
        rasterize_ms=forward[0],
        interpolate_ms=forward[1],
        antialias_ms=forward[2],
        forward_ms=sum(forward),
        backward_ms=backward / FRAMES,
        hardware=hardware(points.device),
    )
