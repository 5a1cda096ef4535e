import copy

import pytest
import torch
from torch.nn import functional

from samira_warp.nets import RegionModulators

SIZE, IN_CHANNELS, CHANNELS, REGIONS = 12, 6, 4, 3


def disjoint_masks(generator):
    """Three disjoint masks with ragged borders; some texels are in none."""
    labels = torch.randint(0, REGIONS + 1, (SIZE, SIZE), generator=generator)
    labels[:, :6] = 1
    return torch.stack([labels == k for k in range(REGIONS)]).float()


def modulators_of(masks, *, shared=False):
    torch.manual_seed(1)
    modulators = RegionModulators(IN_CHANNELS, CHANNELS, masks=masks, shared=shared)
    torch.nn.init.normal_(modulators.smooth.weight)
    return modulators


def literal(modulators, features, masks):
    """Eqs. region_modulation and region_feature as written: mask the input, run phi_k, mask, sum, smooth.

    In float64.
    """
    modulators, features, masks = copy.deepcopy(modulators).double(), features.double(), masks.double()
    total = torch.zeros(1, CHANNELS, SIZE, SIZE, dtype=features.dtype)
    for k, mask in enumerate(masks):
        part = slice(0, CHANNELS) if modulators.shared else slice(k * CHANNELS, (k + 1) * CHANNELS)
        hidden = functional.conv2d(features * mask, modulators.project.weight[part])
        hidden = functional.silu(
            functional.conv2d(hidden, modulators.mix.weight[part], modulators.mix.bias[part], padding=1)
        )
        total = (
            total + functional.conv2d(hidden, modulators.out.weight[part], modulators.out.bias[part]) * mask
        )
    smooth = functional.conv2d(total, modulators.smooth.weight, padding=1, groups=CHANNELS)
    return functional.silu(functional.conv2d(smooth, modulators.blend.weight, modulators.blend.bias))


@pytest.mark.parametrize("shared", [False, True])
def test_grouped_convolutions_equal_one_masked_network_a_region(shared, device, generator):
    masks = disjoint_masks(generator)
    modulators = modulators_of(masks, shared=shared)
    features = torch.randn(1, IN_CHANNELS, SIZE, SIZE, generator=generator)
    expected = literal(modulators, features, masks)
    found = modulators.to(device)(features.to(device)).cpu()
    # four layers of sums of some forty products of about 1, 2^-24 each
    torch.testing.assert_close(found.double(), expected, atol=1e-5, rtol=1e-5)


def test_all_regions_at_once_are_each_its_own(generator):
    """What a GPU computes and what a CPU does, with their gradients."""
    modulators = modulators_of(disjoint_masks(generator))
    features = torch.randn(1, IN_CHANNELS, SIZE, SIZE, generator=generator)
    features.requires_grad_()
    weights = torch.randn(1, CHANNELS, SIZE, SIZE, generator=generator)
    learned = [features, *(getattr(modulators, name).weight for name in ("project", "mix", "out"))]
    found = []
    for compute in (modulators._at_once, modulators._each_its_own):
        value = compute(features)
        found.append([value, *torch.autograd.grad(value, learned, weights)])
    # sums over all texels of products of about 1, in other orders
    torch.testing.assert_close(*found, atol=1e-4, rtol=1e-4)


def test_a_region_sees_nothing_outside_its_mask(generator):
    masks = disjoint_masks(generator)
    modulators = modulators_of(masks)
    modulators.smooth = modulators.blend = torch.nn.Identity()
    features = torch.randn(1, IN_CHANNELS, SIZE, SIZE, generator=generator)
    before = modulators(features)
    for mask in masks:
        after = modulators(torch.where(mask > 0, features, torch.randn_like(features)))
        inside = (mask > 0).expand_as(before)
        assert torch.equal(before[inside], after[inside])
        assert not torch.equal(before, after)


def test_regions_have_modulators_of_their_own(generator):
    masks = disjoint_masks(generator)
    modulators = modulators_of(masks)
    modulators.smooth = modulators.blend = torch.nn.Identity()
    features = torch.randn(1, IN_CHANNELS, SIZE, SIZE, generator=generator)
    before = modulators(features)
    with torch.no_grad():
        modulators.mix.weight[CHANNELS : 2 * CHANNELS].normal_(generator=generator)
    changed = (modulators(features) != before).any(1)[0]
    assert changed[masks[1] > 0].any()
    assert not changed[masks[1] == 0].any()


def test_smoothing_starts_as_a_low_pass(generator):
    modulators = RegionModulators(IN_CHANNELS, CHANNELS, masks=disjoint_masks(generator).float())
    kernel = modulators.smooth.weight[:, 0]
    torch.testing.assert_close(kernel.sum((1, 2)), torch.ones(CHANNELS))
    assert (kernel == kernel[0]).all()
    assert (kernel > 0).all()
    assert kernel[0, 1, 1] == kernel[0].max()


def test_no_routing_is_one_modulator_on_everything(generator):
    ones = torch.ones(1, SIZE, SIZE)
    modulators = modulators_of(ones)
    features = torch.randn(1, IN_CHANNELS, SIZE, SIZE, generator=generator)
    expected = literal(modulators, features, ones)
    torch.testing.assert_close(modulators(features).double(), expected, atol=1e-5, rtol=1e-5)
