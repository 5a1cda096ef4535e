"""Run by test_blending in a process of its own: the kernels written for a GPU against those for a CPU, both
on the CPU, on tiny scenes."""

import torch
import warp as wp

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.raster import blending_cpu, blending_cuda
from samira_warp.kernels.raster.projection import Projection, project
from samira_warp.kernels.raster.slots import GEOMETRY
from samira_warp.kernels.raster.splats import pack_splats
from samira_warp.kernels.raster.tiles import bin_tiles

WIDTH, HEIGHT = 37, 20


def cloud(generator, count, spread, scale):
    """Ellipsoids in front of the camera, and the image's edge in the middle of a tile."""
    means = spread * torch.randn(count, 3, generator=generator) + torch.tensor([0.0, 0.0, 1.0])
    quaternions, scales = (
        torch.randn(count, 4, generator=generator),
        scale * torch.rand(count, 3, generator=generator),
    )
    opacities = torch.rand(count, generator=generator)
    camera = Camera(torch.eye(4), 60.0, 60.0, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
    return project(means, quaternions, scales, opacities, camera)


def pile(count):
    """Gaussians wider than the image, of alpha 0.5: after 13 every pixel has stopped, in the first batch or a
    later one."""
    means2d, depths = torch.tensor([[20.0, 17.0]]).repeat(count, 1), torch.arange(count).float()
    conics = torch.tensor([[1e-12, 0.0, 1e-12]]).repeat(count, 1)
    opacities = torch.full((count,), 0.5)
    return Projection(means2d, depths, conics, opacities, torch.ones(count, dtype=torch.bool))


def compare(generator, projection, channels, at_least):
    """Images and slots of both sides; ``at_least`` Gaussians have to meet in a tile."""
    opacities = projection.opacities
    features = torch.randn(len(opacities), channels, generator=generator)
    bins = bin_tiles(projection, width=WIDTH, height=HEIGHT)
    assert bins.tile_offsets.diff().max() >= at_least, "too few Gaussians in a tile"
    gradients = (
        torch.randn(HEIGHT, WIDTH, channels, generator=generator),
        torch.randn(HEIGHT, WIDTH, generator=generator),
    )
    results = []
    for side in (blending_cpu, blending_cuda, blending_cuda):
        splats = pack_splats(
            projection.means2d, projection.conics, opacities, features, bins, multiple=side.LANES
        )
        images = side.forward(splats, bins, channels, WIDTH, HEIGHT)
        slots = side.adjoint(splats, bins, *images, *gradients)
        written = slots.values[:, : GEOMETRY + channels]
        results.append((*images, torch.where(slots.reached[:, None], written, 0.0)))
    for cpu, cuda, again in zip(*results, strict=True):
        assert torch.equal(cuda, again)
        # rounding of the exponential and of sums over up to 256 pixels
        assert (cpu - cuda).norm() <= 2e-6 * cpu.norm()


if __name__ == "__main__":
    wp.config.enable_cpu_blocks = True
    torch.set_num_threads(1)
    # memory that nobody has written is NaN
    torch.use_deterministic_algorithms(True)
    random = torch.Generator().manual_seed(0)
    batch = blending_cuda.BATCH
    for channel_count in (1, 3, 8, 11, 16):
        compare(random, cloud(random, 90, 0.15, 0.06), channel_count, at_least=batch + 1)
    # more channels than registers hold, the last group a full one and not
    largest = blending_cuda.GROUPS[-1]
    for channel_count in (20, largest, largest + 9):
        compare(random, cloud(random, 60, 0.15, 0.06), channel_count, at_least=1)
    compare(random, cloud(random, 300, 0.2, 0.006), 3, at_least=batch + 1)
    for pile_count in (1, batch - 1, batch, 3 * batch + 1):
        compare(random, pile(pile_count), 2, at_least=pile_count)
    compare(random, cloud(random, 0, 1.0, 1.0), 3, at_least=0)
