"""The GPU's side: every kernel compiles for it anywhere; where there is one, streams, graphs, and the CPU's
results."""

import importlib
import pkgutil

import pytest
import torch
import warp as wp
from kernels.scenes import cloud, turned_camera

from samira_warp import kernels
from samira_warp.kernels.raster.blending import blend
from samira_warp.kernels.raster.projection import project
from samira_warp.kernels.raster.tiles import bin_tiles

WIDTH, HEIGHT = 70, 45
CAPACITY = 8000
OLDEST, NEWEST = 80, 90
"""Compute capabilities. What Warp writes compiles for the one as for the other; native snippets are compiled
for both."""


def cuda_modules():
    """Modules with kernels for a GPU; native snippets for a CPU are in modules of that name."""
    rooms = pkgutil.walk_packages(kernels.__path__, prefix=f"{kernels.__name__}.")
    modules = [importlib.import_module(info.name) for info in rooms if not info.name.endswith("_cpu")]
    return [
        module for module in modules if any(isinstance(value, wp.Kernel) for value in vars(module).values())
    ]


def test_every_room_is_looked_into():
    rooms = {module.__name__.split(".")[-2] for module in cuda_modules()}
    assert rooms >= {"cubemap", "gathering", "mesh", "plain", "raster", "rays", "shading"}


def compiled():
    """Modules, and what they are compiled for here."""
    for module in cuda_modules():
        native = any(getattr(value, "native_snippet", None) for value in vars(module).values())
        for architecture in (OLDEST, NEWEST) if native else (OLDEST,):
            name = module.__name__.rpartition(".")[2]
            yield pytest.param(module, architecture, id=f"{name}-{architecture}")


@pytest.mark.parametrize(("module", "architecture"), list(compiled()))
def test_kernels_compile_for_cuda(module, architecture, tmp_path):
    """Warp brings the compiler; no device is needed."""
    wp.init()
    if architecture not in wp.get_cuda_supported_archs():
        pytest.skip(f"this Warp has no CUDA compiler for sm_{architecture}")
    (text,) = wp.compile_aot_module(module, arch=architecture, module_dir=tmp_path, use_ptx=True)
    assert f".target sm_{architecture}" in text.read_text()


@pytest.fixture
def cuda():
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    return torch.device("cuda")


class Job:
    """Rasterising and its gradients, without a word to the host: inputs that stay where they are, and a fixed
    capacity."""

    def __init__(self, seed, device, channels=4):
        generator = torch.Generator().manual_seed(seed)
        self.inputs = [
            tensor.requires_grad_() for tensor in cloud(generator, device, count=400, channels=channels)
        ]
        self.camera = turned_camera(device, WIDTH, HEIGHT)
        shapes = ((HEIGHT, WIDTH, channels), (HEIGHT, WIDTH))
        self.weights = [torch.randn(shape, generator=generator).to(device) for shape in shapes]

    def run(self, capacity=CAPACITY):
        *gaussians, opacities, features = self.inputs
        size = {"width": WIDTH, "height": HEIGHT}
        projection = project(*gaussians, opacities, self.camera)
        bins = bin_tiles(projection, capacity=capacity, **size)
        found = blend(projection.means2d, projection.conics, projection.opacities, features, bins, **size)
        return *found, *torch.autograd.grad(found, self.inputs, self.weights)

    @torch.no_grad()
    def take_inputs(self, other):
        for mine, theirs in zip(self.inputs, other.inputs, strict=True):
            mine.copy_(theirs)
        for mine, theirs in zip(self.weights, other.weights, strict=True):
            mine.copy_(theirs)


def warm_up(job):
    """Compile, and let every allocator have what it needs, in a stream that is not the default one."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            job.run()
    torch.cuda.current_stream().wait_stream(stream)


def assert_same_bits(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one, other)


@pytest.mark.gpu
@pytest.mark.parametrize("channels", [1, 3, 9, 11, 16, 20, 40])
def test_matches_the_cpu(cuda, channels):
    found = Job(0, cuda, channels).run()
    expected = Job(0, torch.device("cpu"), channels).run()
    for image, truth in zip(found[:2], expected[:2], strict=True):
        # the two exponentials, and conics that round apart, err by some 1e-6 of a weight; a pair that this
        # carries over alpha = 1/255 changes a pixel by up to that times a feature (unit normal: below 5)
        error = (image.cpu() - truth).abs()
        assert (error > 5e-5).float().mean() < 2e-3
        assert error.max() < 5.0 / 255.0 * 2.0
    for gradient, truth in zip(found[2:], expected[2:], strict=True):
        assert (gradient.cpu() - truth).norm() < 2e-3 * truth.norm()
        assert (
            torch.nn.functional.cosine_similarity(gradient.cpu().flatten(), truth.flatten(), dim=0) > 1 - 1e-5
        )


@pytest.mark.gpu
def test_every_run_gives_the_same_bits(cuda):
    job = Job(1, cuda, channels=11)
    first = job.run()
    for _ in range(5):
        assert_same_bits(job.run(), first)


@pytest.mark.gpu
def test_capacity_keeps_the_host_out(cuda):
    job = Job(2, cuda)
    expected = job.run(capacity=None)
    warm_up(job)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        found = job.run()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert_same_bits(found, expected)


@pytest.mark.gpu
def test_works_in_two_streams_at_once(cuda):
    jobs = [Job(seed, cuda) for seed in (3, 4)]
    expected = [job.run() for job in jobs]
    torch.cuda.synchronize()
    streams = [torch.cuda.Stream() for _ in jobs]
    found = []
    for _ in range(10):
        for stream, job in zip(streams, jobs, strict=True):
            with torch.cuda.stream(stream):
                # work in front, so that a kernel that strays into another stream runs ahead of its inputs
                torch.cuda._sleep(1_000_000)
                found.append(job.run())
    torch.cuda.synchronize()
    for index, results in enumerate(found):
        assert_same_bits(results, expected[index % 2])


@pytest.mark.gpu
def test_replays_as_a_graph(cuda):
    """Captured with one scene, replayed with others: the number of intersections may change under the
    capacity."""
    job = Job(5, cuda)
    warm_up(job)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        results = job.run()
    for seed in (5, 6, 7):
        other = Job(seed, cuda)
        expected = other.run()
        job.take_inputs(other)
        graph.replay()
        torch.cuda.synchronize()
        assert_same_bits(results, expected)
