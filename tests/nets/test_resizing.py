"""Resizing by matrix products is torch's pooling and interpolation, and its adjoint theirs."""

import pytest
import torch
from torch.nn import functional

from samira_warp.nets.resizing import resize


@pytest.mark.parametrize("size", [(8, 8), (16, 16), (3, 5), (20, 6), (33, 40)])
def test_it_is_pooling_where_it_shrinks_and_interpolation_where_it_grows(size, device, generator):
    features = torch.randn(1, 4, 16, 16, generator=generator).to(device).requires_grad_()
    exact = features.detach().double().requires_grad_()
    # by rows and by columns one after the other, as both are
    truth = exact
    for height, width in ((16, size[1]), size):
        shrinks = (height, width) < truth.shape[-2:]
        truth = (
            functional.adaptive_avg_pool2d(truth, (height, width))
            if shrinks
            else functional.interpolate(truth, (height, width), mode="bilinear", align_corners=False)
        )
    found = resize(features, like=torch.empty(size))
    # means of at most 6 x 4 values of float32, twice
    torch.testing.assert_close(found.double(), truth, rtol=0, atol=1e-6)
    weights = torch.randn(found.shape, generator=generator).to(device)
    (weights * found).sum().backward()
    (weights.double() * truth).sum().backward()
    torch.testing.assert_close(features.grad.double(), exact.grad, rtol=0, atol=1e-5)


def test_the_same_size_is_the_same_map():
    features = torch.randn(1, 2, 7, 7)
    assert resize(features, like=torch.empty(7, 7)) is features


def test_an_even_map_stays_even():
    even = torch.full((1, 1, 12, 12), 0.75)
    # weights of a row sum to 1 within 2^-24 each
    torch.testing.assert_close(
        resize(even, like=torch.empty(5, 31)), torch.full((1, 1, 5, 31), 0.75), rtol=1e-6, atol=0
    )
