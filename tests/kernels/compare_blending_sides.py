"""Run by test_blending in a process of its own: the kernels written for a GPU against those for a CPU, both on the CPU, on a tiny scene."""

import torch
import warp as wp

from samira_warp.camera import Camera
from samira_warp.kernels import blending_cpu, blending_cuda
from samira_warp.kernels.projection import project
from samira_warp.kernels.splats import pack_splats
from samira_warp.kernels.tiles import bin_tiles

WIDTH, HEIGHT, COUNT = 37, 20, 90


def compare(channels: int) -> None:
    generator = torch.Generator().manual_seed(channels)
    means = 0.15 * torch.randn(COUNT, 3, generator=generator) + torch.tensor([0.0, 0.0, 1.0])
    quaternions, scales = torch.randn(COUNT, 4, generator=generator), 0.06 * torch.rand(COUNT, 3, generator=generator)
    opacities, features = torch.rand(COUNT, generator=generator), torch.randn(COUNT, channels, generator=generator)
    camera = Camera(torch.eye(4), 60.0, 60.0, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
    projection = project(means, quaternions, scales, opacities, camera)
    bins = bin_tiles(projection, opacities, width=WIDTH, height=HEIGHT)
    assert bins.tile_offsets.diff().max() > blending_cuda.VOTE, "too few Gaussians in a tile to reach a vote"

    gradients = (torch.randn(HEIGHT, WIDTH, channels, generator=generator), torch.randn(HEIGHT, WIDTH, generator=generator))
    results = []
    for side in (blending_cpu, blending_cuda):
        splats = pack_splats(projection.means2d, projection.conics, opacities, features, multiple=side.LANES)
        images = side.forward(splats, bins, channels, WIDTH, HEIGHT)
        results.append((*images, side.adjoint(splats, bins, *images, *gradients)))
    for cpu, cuda in zip(*results, strict=True):
        # rounding of the exponential and of sums over up to 256 pixels
        assert ((cpu - cuda).norm() / cpu.norm()).item() < 2e-6


if __name__ == "__main__":
    wp.config.enable_cpu_blocks = True
    torch.set_num_threads(1)
    for channel_count in (3, 20):
        compare(channel_count)
