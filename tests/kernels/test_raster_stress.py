"""The whole rasteriser where a scene is hostile, crowded, huge or oddly shaped."""

import math
import subprocess
import sys

import pytest
import torch
from kernels.scenes import block, straight_camera

from samira_warp.kernels.plain import blending as blending_plain
from samira_warp.kernels.raster.projection import project
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.kernels.raster.tiles import bin_tiles
from samira_warp.reference.raster.rasterizer import rasterize as reference_rasterize
from samira_warp.support.constants import NEAR_PLANE

CHANNELS = 3


def one_gaussian(device, depth=1.0, scale=0.05, opacity=0.5):
    """An ellipsoid on the camera's axis, askew."""
    values = (
        [0.0, 0.0, depth],
        [0.8, 0.3, -0.4, 0.6],
        [scale, 1.7 * scale, 0.6 * scale],
        opacity,
        [1.0, -2.0, 0.5],
    )
    return [torch.tensor(value, device=device)[None] for value in values]


def joined(*scenes):
    return [torch.cat(tensors) for tensors in zip(*scenes, strict=True)]


def make_weights(generator, camera):
    """A random linear functional of features and alpha."""
    shapes = ((camera.height, camera.width, CHANNELS), (camera.height, camera.width))
    return [torch.randn(shape, generator=generator).to(camera.world_to_camera) for shape in shapes]


def with_gradients(function, scene, camera, weights):
    leaves = [tensor.clone().requires_grad_() for tensor in scene]
    images = function(*leaves, camera)[:2]
    return images, torch.autograd.grad(images, leaves, [weight.to(images[0].dtype) for weight in weights])


def assert_matches_the_twin(scene, camera, weights, groups=(slice(None),)):
    """The images, and the gradients of each group of Gaussians by itself: a large one would hide a small
    one's error."""
    images, gradients = with_gradients(rasterize, scene, camera, weights)
    expected, truths = with_gradients(
        reference_rasterize, [tensor.double() for tensor in scene], camera, weights
    )
    assert expected[1].max() > 0.2
    for image, truth in zip(images, expected, strict=True):
        # a pair that flips at alpha = 1/255 changes a pixel by at most that, times a feature of 4; otherwise
        # float32 rounds
        assert ((image - truth).abs() > 5e-5).float().mean() < 5e-3
        assert (image - truth).abs().max() < 0.02
    for group in groups:
        for gradient, truth in zip(
            (gradient[group].double() for gradient in gradients),
            (truth[group] for truth in truths),
            strict=True,
        ):
            # flipped pairs again: 1/255 of a pixel's gradient. Where the truth is 0, so is ours
            assert (gradient - truth).norm() <= 3e-3 * truth.norm()


UNUSABLE = {
    "behind the camera": {"depth": -1.0},
    "at the camera": {"depth": 0.0},
    "on the near plane": {"depth": NEAR_PLANE},
    "NaN scale": {"scale": math.nan},
    "infinite scale": {"scale": math.inf},
    "wider than float32": {"scale": 1e30},
    "opacity 0": {"opacity": 0.0},
    "NaN opacity": {"opacity": math.nan},
}


def test_unusable_gaussians_leave_no_trace_all_at_once(device, generator):
    healthy, camera = block(generator, device, 300), straight_camera(device, 70, 50)
    weights = make_weights(generator, camera)
    broken = joined(*(one_gaussian(device, **kind) for kind in UNUSABLE.values()))
    # first, between and last: wherever they stand in the input
    mixed = joined(
        broken, [tensor[:150] for tensor in healthy], broken, [tensor[150:] for tensor in healthy], broken
    )
    count = len(UNUSABLE)
    kept = torch.cat([torch.arange(150) + count, torch.arange(150) + 2 * count + 150]).to(device)
    images, gradients = with_gradients(rasterize, healthy, camera, weights)
    mixed_images, mixed_gradients = with_gradients(rasterize, mixed, camera, weights)
    for one, other in zip(images, mixed_images, strict=True):
        assert torch.equal(one, other)
    for one, other in zip(gradients, mixed_gradients, strict=True):
        assert torch.equal(one, other[kept])
        others = torch.ones(len(other), dtype=torch.bool, device=device).index_fill_(0, kept, False)
        assert (other[others] == 0).all()


@pytest.mark.parametrize(
    "kind",
    [
        {"depth": 1.01 * NEAR_PLANE, "scale": 1e-3},  # just beyond the near plane
        {"depth": 0.02, "scale": 1.0},  # 3,000 pixels wide
        {"depth": 1.0, "scale": 100.0},  # 6,000 pixels wide
        {"scale": 0.0},
        {"opacity": 1.0},
        {"opacity": 1.0 / 256.0},  # too little for a pixel of 8 bits
    ],
    ids=["near plane", "wide and near", "wide", "scale 0", "opacity 1", "opacity 1/256"],
)
def test_extreme_gaussians_match_the_twin(device, generator, kind):
    # in front of the others, among them and behind them
    extreme = [
        one_gaussian(device, **{**kind, "depth": kind.get("depth", depth)}) for depth in (0.4, 1.0, 1.8)
    ]
    scene, camera = joined(*extreme, block(generator, device, 100)), straight_camera(device, 45, 38)
    assert_matches_the_twin(
        scene, camera, make_weights(generator, camera), groups=(slice(0, 3), slice(3, None))
    )


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 33), (33, 1), (4096, 16), (16, 4096)])
def test_sizes_match_the_twin(device, generator, width, height):
    count = 40 if max(width, height) > 100 else 200
    scene = block(generator, device, count, extent=(width / 120, height / 120), scale=0.1)
    camera = straight_camera(device, width, height)
    assert_matches_the_twin(scene, camera, make_weights(generator, camera))


def test_a_hundred_thousand_in_one_tile(generator):
    """Specks that seldom cover two pixels, so that no pixel is full before it has seen them all."""
    camera = straight_camera("cpu", 16, 16)
    scene = block(generator, "cpu", 200_000, extent=(0.06, 0.06), scale=1e-3, opacity=(0.08, 0.12))
    weights = make_weights(generator, camera)
    projection = project(*scene[:4], camera)
    bins = bin_tiles(projection, width=16, height=16)
    assert bins.tile_offsets.tolist() == [0, len(bins.gaussians)]
    assert len(bins.gaussians) > 100_000

    inputs = [projection.means2d, projection.conics, projection.opacities, scene[4]]
    plain = blending_plain.blend(*inputs, bins, bins.gaussians, width=16, height=16)
    assert plain.transmittance.min() > 1e-3
    truths = blending_plain.blend_adjoint(*inputs, bins, bins.gaussians, plain, weights[0], -weights[1])
    images, gradients = with_gradients(rasterize, scene, camera, weights)
    # some hundred terms a pixel, each of which rounds by 2^-24, and a few pairs that flip at alpha = 1/255
    assert (images[0] - plain.features).norm() < 1e-3 * plain.features.norm()
    assert (images[1] + plain.transmittance - 1).abs().max() < 1e-3
    # of an opacity, what the low-pass leaves arrives in the picture
    left = projection.opacities / scene[3]
    for gradient, truth in zip(gradients[3:], (left * truths[2], truths[3]), strict=True):
        assert (gradient - truth).norm() < 1e-3 * truth.norm()


def test_a_permutation_changes_nothing_but_the_order_of_equal_depths(device, generator):
    camera = straight_camera(device, 70, 50)
    scene = block(generator, device, 400)
    scene[0][:, 2] = 0.6 + 0.1 * torch.randint(8, (400,), generator=generator).to(
        device
    )  # eight depths, some fifty Gaussians each
    weights = make_weights(generator, camera)
    shuffle = torch.randperm(400, generator=generator).to(device)
    # by depth again, but with depths shuffled against each other: equal ones keep their order
    groups = scene[0][:, 2].unique()[torch.randperm(8, generator=generator).to(device)]
    within = torch.cat([(scene[0][:, 2] == depth).nonzero()[:, 0] for depth in groups])
    results = {
        name: with_gradients(rasterize, [tensor[order] for tensor in scene], camera, weights)
        for name, order in (
            ("as is", torch.arange(400, device=device)),
            ("within", within),
            ("shuffled", shuffle),
        )
    }
    for one, other in zip(results["as is"][0], results["within"][0], strict=True):
        assert torch.equal(one, other)
    for one, other in zip(results["as is"][1], results["within"][1], strict=True):
        assert torch.equal(one[within], other)
    assert not torch.equal(results["as is"][0][0], results["shuffled"][0][0])

    scene[0][:, 2] += 1e-4 * torch.arange(400, device=device)  # no two alike: now any permutation will do
    images, gradients = with_gradients(rasterize, scene, camera, weights)
    shuffled_images, shuffled_gradients = with_gradients(
        rasterize, [tensor[shuffle] for tensor in scene], camera, weights
    )
    for one, other in zip(images, shuffled_images, strict=True):
        assert torch.equal(one, other)
    for one, other in zip(gradients, shuffled_gradients, strict=True):
        assert torch.equal(one[shuffle], other)


def test_bits_do_not_depend_on_threads_or_a_second_backward(generator, use_threads):
    camera = straight_camera("cpu", 300, 200, focal=300.0)
    scene = block(generator, "cpu", 20_000, extent=(0.5, 0.4), scale=0.005)
    weights = make_weights(generator, camera)
    runs = []
    for threads in (1, 2):
        use_threads(threads)
        leaves = [tensor.clone().requires_grad_() for tensor in scene]
        found = rasterize(*leaves, camera)
        for _ in range(2):
            runs.append((*found[:4], *torch.autograd.grad(found[:2], leaves, weights, retain_graph=True)))
    for results in zip(*runs, strict=True):
        for other in results[1:]:
            assert torch.equal(results[0], other)


MILLION = """
import re
from pathlib import Path
import torch
from samira_warp.bench.raster import GBUFFER_CHANNELS
from samira_warp.bench.disc import make_disc
from samira_warp.kernels.raster.rasterizer import rasterize

scene = make_disc(1_000_000, 1024, torch.device("cpu"))
leaves = [scene.means, scene.quaternions, scene.scales, scene.opacities, scene.features(GBUFFER_CHANNELS)]
leaves = [leaf.requires_grad_() for leaf in leaves]
found = rasterize(*leaves, scene.camera)
torch.autograd.grad(found[:2], leaves, scene.image_gradients(GBUFFER_CHANNELS))
assert found.visible.sum() > 900_000
print(1024 * int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_million_gaussians_stay_within_two_gigabytes():
    """Of the whole process, Python and torch included: forward and backward with the G-buffer's channels.

    The kernel's own peak of a process counts what its parent held when it was started; that of its memory map
    does not.
    """
    done = subprocess.run([sys.executable, "-c", MILLION], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 2 * 10**9
