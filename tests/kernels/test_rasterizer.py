import math

import pytest
import torch
from kernels.scenes import cloud, turned_camera

from samira_warp.kernels.raster.blending import blend
from samira_warp.kernels.raster.projection import project
from samira_warp.kernels.raster.rasterizer import rasterize
from samira_warp.kernels.raster.tiles import bin_tiles
from samira_warp.reference.raster.rasterizer import rasterize as reference_rasterize


@pytest.mark.parametrize(("width", "height"), [(48, 32), (37, 41), (1, 1)])
def test_matches_the_twin(device, generator, width, height):
    scene, camera = cloud(generator, device), turned_camera(device, width, height)
    weights = [
        torch.randn(height, width, 4, generator=generator).to(device),
        torch.randn(height, width, generator=generator).to(device),
    ]
    inputs = [tensor.clone().requires_grad_() for tensor in scene]
    found = rasterize(*inputs, camera)
    gradients = torch.autograd.grad(found[:2], inputs, weights)
    doubles = [tensor.double().requires_grad_() for tensor in scene]
    expected = reference_rasterize(*doubles, camera)[:2]
    truths = torch.autograd.grad(expected, doubles, [weight.double() for weight in weights])
    for image, truth in zip(found[:2], expected, strict=True):
        # a pair that flips at alpha = 1/255 changes a pixel by at most that, times a feature; see
        # test_blending
        assert ((image - truth).abs() > 5e-5).float().mean() < 5e-3
        assert (image - truth).abs().max() < 0.04
    for gradient, truth in zip(gradients, truths, strict=True):
        assert (gradient.double() - truth).norm() < 3e-3 * truth.norm()
        assert (
            torch.nn.functional.cosine_similarity(gradient.double().flatten(), truth.flatten(), dim=0)
            > 1 - 1e-5
        )


def with_capacity(means, quaternions, scales, opacities, features, camera, capacity):
    """As `rasterize`, with room for a fixed number of intersections; also what `project` found."""
    size = {"width": camera.width, "height": camera.height}
    projection = project(means, quaternions, scales, opacities, camera)
    bins = bin_tiles(projection, capacity=capacity, **size)
    seen = (projection.means2d, projection.conics, projection.opacities)
    return blend(*seen, features, bins, **size), projection


def test_capacity_does_not_change_the_picture(device, generator):
    scene, camera = cloud(generator, device), turned_camera(device, 50, 40)
    inputs = [tensor.clone().requires_grad_() for tensor in scene]
    plain = rasterize(*inputs, camera)
    roomy, _ = with_capacity(*inputs, camera, 5000)
    results = [
        (features, alpha, *torch.autograd.grad(features.square().sum() + alpha.sum(), inputs))
        for features, alpha in (
            (plain.features, plain.alpha),
            (roomy.features, 1.0 - roomy.transmittance),
        )
    ]
    for one, other in zip(*results, strict=True):
        assert torch.equal(one, other)


def test_a_capacity_that_is_too_small_loses_the_farthest_and_stays_finite(device, generator):
    scene, camera = cloud(generator, device), turned_camera(device, 50, 40)
    inputs = [tensor.clone().requires_grad_() for tensor in scene]
    found, projection = with_capacity(*inputs, camera, 100)
    gradients = torch.autograd.grad(found.features.square().sum(), inputs)
    used = gradients[4].abs().sum(dim=1) > 0
    assert 0 < used.sum() < projection.visible.sum()
    assert all(gradient.isfinite().all() for gradient in gradients)
    assert projection.depths[used].max() < projection.depths[projection.visible & ~used].max()


def test_screen_gradients_reach_the_caller(device, generator):
    scene, camera = cloud(generator, device), turned_camera(device, 50, 40)
    scene[0].requires_grad_()
    found = rasterize(*scene, camera)
    found.means2d.retain_grad()
    found.features.square().sum().backward()
    assert (found.means2d.grad[found.visible].abs().sum(dim=1) > 0).any()
    assert (found.means2d.grad[~found.visible] == 0).all()


@pytest.mark.parametrize("count", [0, 1])
def test_behind_the_camera_there_is_nothing(device, count):
    camera = turned_camera(device, 20, 20)
    scene = cloud(torch.Generator().manual_seed(0), device, count=count)
    scene[0][:, 2] -= 9.0
    inputs = [tensor.requires_grad_() for tensor in scene]
    found = rasterize(*inputs, camera)
    assert (found.features == 0).all()
    assert (found.alpha == 0).all()
    (found.features.sum() + found.alpha.sum()).backward()
    for tensor in inputs:
        assert tensor.grad.shape == tensor.shape
        assert (tensor.grad == 0).all()


def test_one_bad_gaussian_spoils_nothing(device, generator):
    scene, camera = cloud(generator, device), turned_camera(device, 50, 40)
    without = rasterize(*(torch.cat([tensor[:50], tensor[51:]]) for tensor in scene), camera)
    for field in range(4):
        broken = [tensor.clone() for tensor in scene]
        broken[field][50] = math.nan
        inputs = [tensor.requires_grad_() for tensor in broken]
        found = rasterize(*inputs, camera)
        assert torch.equal(found.features, without.features)
        gradients = torch.autograd.grad(found.features.square().sum(), inputs)
        assert all(gradient.isfinite().all() for gradient in gradients)
        assert all((gradient[50] == 0).all() for gradient in gradients)
